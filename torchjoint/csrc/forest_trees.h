// The trees of a structured forest, checked and laid out for walks from the root to a leaf.
#pragma once

#include <cmath>

#include "array.h"
#include "common.h"
#include "forest_tile.h"

namespace torchjoint {

// Side of the square of pixels that a leaf votes for.
constexpr int64_t kVotes = 16;

// An inner node. A child >= 0 is the number of an inner node of the same tree; a child < 0 is the complement of the
// number of a leaf.
struct Node {
  float threshold;
  Feature feature;
  int32_t child[2];  // left, right
};

// All trees, checked, in a layout in which each step of a walk reads one node.
struct Forest {
  Forest(const Tensor& children, const Tensor& features, const Tensor& thresholds, const Tensor& counts,
         const Tensor& pixels, int64_t trees_per_site)
      : num_trees(children.size(0)), per_site(trees_per_site), pixel(pixels.const_data_ptr<uint8_t>()),
        start(children.size(0) * children.size(1) + 1), nodes(start.size()) {
    const int64_t length = children.size(1), total = num_trees * length, num_pixels = pixels.size(0);
    const int32_t* const count = counts.const_data_ptr<int32_t>();
    int64_t end = 0;
    int32_t signs = 0;
    for (int64_t i = 0; i < total; ++i) {
      signs |= count[i];
      start[i] = static_cast<int32_t>(end);
      end += count[i];
    }
    for (int64_t i = 0; signs < 0 && i < total; ++i) {
      check(count[i] >= 0, "boundary_counts: expected counts >= 0, got ", count[i], " at node ", i % length,
            " of tree ", i / length);
    }
    check(end == num_pixels, "boundary_counts: expected counts of ", num_pixels, " pixels in all, got ", end);
    start[total] = static_cast<int32_t>(end);
    Scratch scratch(length);
    int32_t used = 0;
    for (int64_t tree = 0; tree < num_trees; ++tree) {
      const int64_t first = tree * length;
      used = add_tree({children.const_data_ptr<int32_t>() + first, features.const_data_ptr<int32_t>() + first,
                       thresholds.const_data_ptr<float>() + first, static_cast<int32_t>(length)},
                      tree, used, scratch);
    }
  }

  // One tree as given: `child` is 0 at a leaf, else 1 + the place of the left child; the right child is the next node.
  struct Given {
    const int32_t *child, *feature;
    const float* threshold;
    int32_t length;

    // Whether the node is a leaf or a valid inner node. A child comes after its parent, so there are no cycles.
    int32_t fits(int32_t place) const {
      const int32_t inside = (child[place] > place + 1) & (child[place] < length);
      const int32_t known = static_cast<uint32_t>(feature[place]) < static_cast<uint32_t>(kFeatures);
      const int32_t finite = std::abs(threshold[place]) <= std::numeric_limits<float>::max();
      return (child[place] == 0) | (inside & known & finite);
    }
  };

  // `inner`: the places of the inner nodes of a tree. `number`: for each place the number of the inner node, or the
  // complement of the number of the leaf.
  struct Scratch {
    explicit Scratch(int64_t length) : inner(length), number(length) {}
    std::vector<int32_t> inner, number;
  };

  // Writes the inner nodes of a tree behind the first `used` of `nodes`; returns the new number of used nodes. No branch
  // depends on whether a node is a leaf, because half of the predictions would be wrong.
  int32_t add_tree(const Given& given, int64_t tree, int32_t used, Scratch& scratch) {
    int32_t fits = 1;
    for (int32_t place = 0; place < given.length; ++place) fits &= given.fits(place);
    if (!fits) fail_at(given, tree);
    const auto& [inner, number] = scratch;
    int32_t num_inner = 0;
    for (int32_t place = 0; place < given.length; ++place) {
      scratch.inner[num_inner] = place;
      num_inner += given.child[place] != 0;
    }
    const int32_t first_leaf = static_cast<int32_t>(tree * given.length);
    for (int32_t place = 0; place < given.length; ++place) scratch.number[place] = ~(first_leaf + place);
    for (int32_t i = 0; i < num_inner; ++i) scratch.number[inner[i]] = i;
    root.push_back({used, number[0]});
    const std::array<Feature, kFeatures>& features = tile_features();
    for (int32_t i = 0; i < num_inner; ++i) {
      const int32_t place = inner[i], right = given.child[place];
      nodes[used + i] = {given.threshold[place], features[given.feature[place]], {number[right - 1], number[right]}};
    }
    return used + num_inner;
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

  // Whether a tree votes at a site whose row + column is `turn`; neighbouring sites use different trees.
  bool votes(int64_t tree, int64_t turn) const {
    return (tree - turn % (2 * per_site) + 2 * num_trees) % num_trees < per_site;
  }

  struct Root {
    int32_t first, node;  // index of the tree's first inner node; node at which its walks begin
  };

  int64_t num_trees, per_site;
  const uint8_t* pixel;  // column * 16 + row
  Array<int32_t> start;  // for each leaf, the index of its first pixel
  Array<Node> nodes;
  std::vector<Root> root;
};

}  // namespace torchjoint
