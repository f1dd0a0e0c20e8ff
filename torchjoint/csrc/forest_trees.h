// The trees of a structured forest, checked and laid out for walks from the root to a leaf.
#pragma once

#include <array>
#include <cmath>

#include "array.h"
#include "common.h"
#include "forest_channels.h"

namespace torchjoint {

// Side of a patch in cells of the channels, two pixels wide; side of the square of pixels that a leaf votes for.
constexpr int64_t kPatch = 16, kVotes = 16;
// Features: single values (channel, column, row), then differences of a channel between two cells of a 5 x 5 grid.
constexpr int64_t kGrid = 5, kPairs = kGrid * kGrid * (kGrid * kGrid - 1) / 2;
constexpr int64_t kSingle = kChannels * kPatch * kPatch, kFeatures = kSingle + kChannels * kPairs;
constexpr std::array<int64_t, kGrid> kGridCells{1, 4, 8, 11, 14};

// An inner node. A child >= 0 is an inner node of the same tree; of a leaf it is the complement of the leaf's number.
struct Node {
  float threshold;
  int32_t feature;
  int32_t child[2];  // left, right
};

// All trees, checked, and laid out for walks: a step reads one node.
struct Forest {
  Forest(const Tensor& children, const Tensor& features, const Tensor& thresholds, const Tensor& counts,
         const Tensor& pixels, int64_t trees_per_site)
      : num_trees(children.size(0)), per_site(trees_per_site), pixel(pixels.const_data_ptr<uint8_t>()),
        start(children.size(0) * children.size(1) + 1), nodes(start.size()) {
    const int64_t length = children.size(1), total = num_trees * length, num_pixels = pixels.size(0);
    const int32_t* const count = counts.const_data_ptr<int32_t>();
    int64_t end = 0;
    for (int64_t i = 0; i < total; ++i) {
      if (count[i] < 0) [[unlikely]] {
        fail("boundary_counts: expected counts >= 0, got ", count[i], " at node ", i % length, " of tree ", i / length);
      }
      start[i] = static_cast<int32_t>(std::min(end, num_pixels));
      end += count[i];
    }
    check(end == num_pixels, "boundary_counts: expected counts of ", num_pixels, " pixels in all, got ", end);
    start[total] = static_cast<int32_t>(end);
    std::vector<int32_t> number(length);
    int32_t used = 0;
    for (int64_t tree = 0; tree < num_trees; ++tree) {
      const int64_t first = tree * length;
      used = add_tree({children.const_data_ptr<int32_t>() + first, features.const_data_ptr<int32_t>() + first,
                       thresholds.const_data_ptr<float>() + first, length}, tree, used, number);
    }
  }

  // One tree as it is given: 0 at a leaf, else one more than the left child's place; the right child follows.
  struct Given {
    const int32_t *child, *feature;
    const float* threshold;
    int64_t length;

    bool fits(int64_t place) const {
      // A child comes after its parent, so there are no circles.
      const bool inside = (child[place] > place + 1) & (child[place] < length);
      const bool known = (feature[place] >= 0) & (feature[place] < kFeatures);
      const bool finite = std::abs(threshold[place]) <= std::numeric_limits<float>::max();
      return (child[place] == 0) | (inside & known & finite);
    }
  };

  // Appends the inner nodes to `nodes`, of which the first `used` are taken; returns how many are then. No branch
  // depends on what is a leaf, because it would be predicted wrongly half of the time.
  int32_t add_tree(const Given& given, int64_t tree, int32_t used, std::vector<int32_t>& number) {
    const int32_t first_leaf = static_cast<int32_t>(tree * given.length);
    int32_t inner = 0;
    bool fits = true;
    for (int64_t place = 0; place < given.length; ++place) {
      const bool is_inner = given.child[place] != 0;
      number[place] = is_inner ? inner : ~static_cast<int32_t>(first_leaf + place);
      inner += is_inner;
      fits &= given.fits(place);
    }
    if (!fits) fail_at(given, tree);
    root.push_back({used, number[0]});
    for (int64_t place = 0; place < given.length; ++place) {
      const int32_t child = std::max(given.child[place], 1);
      const int32_t right = number[std::min<int64_t>(child, given.length - 1)];
      nodes[used] = {given.threshold[place], given.feature[place], {number[child - 1], right}};
      used += given.child[place] != 0;
    }
    return used;
  }

  [[noreturn]] static void fail_at(const Given& given, int64_t tree) {
    for (int64_t place = 0; place < given.length; ++place) {
      if (given.fits(place)) continue;
      const int32_t child = given.child[place], feature = given.feature[place];
      check(child > place + 1 && child < given.length,
            "children: expected 0, or more than the node's place + 1 and less than ", given.length, ", got ", child,
            " at node ", place, " of tree ", tree);
      check(feature >= 0 && feature < kFeatures, "features: expected numbers in [0, ", kFeatures, "), got ", feature,
            " at node ", place, " of tree ", tree);
      fail("thresholds: expected finite numbers, got ", given.threshold[place], " at node ", place, " of tree ", tree);
    }
    fail("children: expected a tree");
  }

  // Whether a tree votes at a site whose row and column add up to `turn`, modulo turns(): neighbouring sites ask
  // different trees.
  bool votes(int64_t tree, int64_t turn) const {
    return ((tree - turn) % num_trees + num_trees) % num_trees < per_site;
  }

  int64_t turns() const { return 2 * per_site; }

  struct Root {
    int32_t first, node;  // where the tree's inner nodes begin, and where its walks do
  };

  int64_t num_trees, per_site;
  const uint8_t* pixel;  // column * 16 + row
  Array<int32_t> start;  // of each leaf's pixels
  Array<Node> nodes;
  std::vector<Root> root;
};

}  // namespace torchjoint
