// A k-d tree over points: leaves with equal numbers of points, in the order of the tree, and their boxes. It is balanced,
// except where most points of a node lie in a tiny part of its box: there few points are cut off.
#pragma once

#include "array.h"
#include "common.h"

#include <tuple>
#include <utility>

namespace torchjoint {

template <typename Value>
struct Box {
  Value low[3], high[3];
};

// The squared distance of a place from a box; 0 inside.
template <typename Value>
Value squared_gap(const Value* place, const Box<Value>& box) {
  Value sum = 0;
  for (int d = 0; d < 3; ++d) {
    const Value gap = std::max(std::max(box.low[d] - place[d], place[d] - box.high[d]), Value{0});
    sum += gap * gap;
  }
  return sum;
}

template <typename Value>
class PointTree {
 public:
  static constexpr int64_t kLeafSize = 16;

  // The points of a leaf, one array per coordinate, for vector instructions. The last leaf may have fewer points.
  struct Leaf {
    Value at[3][kLeafSize];
    int32_t index[kLeafSize];  // of the points in the input
  };

  PointTree(const Value* points, int64_t num_points)
      : num_points_(num_points), num_leaves_((num_points + kLeafSize - 1) / kLeafSize), leaves_(num_leaves_),
        low_{Array<Value>(num_leaves_), Array<Value>(num_leaves_), Array<Value>(num_leaves_)},
        high_{Array<Value>(num_leaves_), Array<Value>(num_leaves_), Array<Value>(num_leaves_)},
        boxes_(std::max<int64_t>(2 * num_leaves_ - 1, 0)), middles_(std::max<int64_t>(2 * num_leaves_ - 1, 0)) {
    if (num_points == 0) return;
    Array<Point> moved(num_points);
    parallel_for_each(num_points, 1 << 14, [&](int64_t i) {
      moved[i] = {{points[3 * i], points[3 * i + 1], points[3 * i + 2]}, static_cast<int32_t>(i)};
    });
    build(moved.data());
  }

  int64_t num_leaves() const { return num_leaves_; }
  const Leaf& leaf(int64_t number) const { return leaves_[number]; }

  // The number of points in the leaves [first, last).
  int64_t num_points(int64_t first, int64_t last) const {
    return std::min(last * kLeafSize, num_points_) - first * kLeafSize;
  }

  // The smallest range of leaves of a node of the tree that holds the leaf and at least `count` points, if there is one.
  std::pair<int64_t, int64_t> leaves_around(int64_t leaf, int64_t count) const {
    Node node{0, 0, num_leaves_, 0};
    while (node.last - node.first > 1) {
      const auto [one, other] = parts(node);
      const Node& part = leaf < one.last ? one : other;
      if (num_points(part.first, part.last) < count) break;
      node = part;
    }
    return {node.first, node.last};
  }

  // Writes the leaves whose boxes are at most sqrt(limit) from a place.
  void leaves_near(const Value* place, Value limit, std::vector<int32_t>& found) const {
    size_t size = 0;
    Node stack[64];  // the depth of the tree + 1 is used, at most 31 + kMostCuts + 1
    int depth = 0;
    stack[depth++] = {0, 0, num_leaves_, 0};
    while (depth > 0) {
      const Node node = stack[--depth];
      if (squared_gap(place, boxes_[node.id]) > limit) continue;
      if (node.last - node.first > kFewLeaves) {
        const auto [one, other] = parts(node);
        stack[depth++] = other;
        stack[depth++] = one;
        continue;
      }
      if (size + kFewLeaves > found.size()) found.resize(2 * (size + kFewLeaves));
      Value gap[kFewLeaves];
      squared_gaps(place, node.first, node.last, gap);
      for (int64_t leaf = node.first; leaf < node.last; ++leaf) {
        found[size] = static_cast<int32_t>(leaf);
        size += gap[leaf - node.first] <= limit;
      }
    }
    found.resize(size);
  }

 private:
  struct Point {
    Value at[3];
    int32_t index;
  };

  // The leaves of a node with at most so many leaves are tested at once: this is faster than testing its halves.
  static constexpr int64_t kFewLeaves = 8;

  // A node is a range of leaves; its first half is the next node, and its second half follows all nodes of the first.
  struct Node {
    int64_t id, first, last;
    int cuts;  // on the way to this node
  };

  // Samples of a node that are compared, and the share of its box inside which most of them are close together.
  static constexpr int kSamples = 9, kMostCuts = 24;
  static constexpr Value kTinyShare = Value{1} / 512;

  std::pair<Node, Node> parts(const Node& node) const {
    const int64_t middle = middles_[node.id];
    const int cuts = node.cuts + (middle != (node.first + node.last + 1) / 2);
    return {{node.id + 1, node.first, middle, cuts}, {node.id + 2 * (middle - node.first), middle, node.last, cuts}};
  }

  // Builds the upper levels of the tree one by one, then subtrees in parallel: so all threads soon have work.
  void build(Point* points) {
    std::vector<Node> level{{0, 0, num_leaves_, 0}};
    for (int depth = 0; depth < 6; ++depth) {
      std::vector<Node> next(2 * level.size());
      parallel_for_each(level.size(), 1,
                        [&](int64_t i) { std::tie(next[2 * i], next[2 * i + 1]) = halves(points, level[i]); });
      std::erase_if(next, [](const Node& node) { return node.first == node.last; });
      level = std::move(next);
    }
    parallel_for_each(level.size(), 1, [&](int64_t i) { build_below(points, level[i]); });
  }

  void build_below(Point* points, const Node& node) {
    const auto [one, other] = halves(points, node);
    if (one.first == one.last) return;
    build_below(points, one);
    build_below(points, other);
  }

  // Measures the box of a node, and divides its points into two parts along the longest side of the box. Points with
  // equal coordinates may go to either part.
  std::pair<Node, Node> halves(Point* points, const Node& node) {
    Point *const from = points + node.first * kLeafSize, *const to = from + num_points(node.first, node.last);
    const Box<Value>& box = boxes_[node.id] = box_of(from, to);
    if (node.last - node.first == 1) return fill(node.first, from, to, box), std::pair<Node, Node>{};
    int longest = 0;
    for (int d = 1; d < 3; ++d) {
      if (box.high[d] - box.low[d] > box.high[longest] - box.low[longest]) longest = d;
    }
    const int64_t middle = middles_[node.id] = middle_of(node, from, to, box, longest);
    const auto part = [&]<int d>() {
      std::nth_element(from, points + middle * kLeafSize, to,
                       [](const Point& a, const Point& b) { return a.at[d] < b.at[d]; });
    };
    longest == 0   ? part.template operator()<0>()
    : longest == 1 ? part.template operator()<1>()
                   : part.template operator()<2>();
    return parts(node);
  }

  // The leaf that begins the second part of a node: the middle one. If most of some samples lie in a tiny part of the
  // side, it is where most of the other points are cut off: else each leaf of a dense cluster in a room would have a
  // point of the room and a large box, and each search near the cluster would test all of these.
  static int64_t middle_of(const Node& node, const Point* from, const Point* to, const Box<Value>& box, int d) {
    const int64_t half = (node.first + node.last + 1) / 2;
    if (node.cuts == kMostCuts || to - from < 4 * kLeafSize) return half;
    Value sample[kSamples];
    for (int i = 0; i < kSamples; ++i) sample[i] = from[(to - from - 1) * i / (kSamples - 1)].at[d];
    std::sort(sample, sample + kSamples);
    const Value low = sample[2], high = sample[kSamples - 3], side = box.high[d] - box.low[d];
    if (!(high - low < kTinyShare * side)) return half;
    const bool cut_low = low - box.low[d] > box.high[d] - high;
    const Value border = cut_low ? low - kTinyShare * side : high + kTinyShare * side;
    const int64_t below = std::count_if(from, to, [&](const Point& point) { return point.at[d] < border; });
    const int64_t leaf = node.first + (cut_low ? below : below + kLeafSize - 1) / kLeafSize;
    return std::clamp(leaf, node.first + 1, node.last - 1);
  }

  // As squared_gap, for the boxes of leaves [first, last): vector instructions test several at once.
  void squared_gaps(const Value* place, int64_t first, int64_t last, Value* gap) const {
    const Value px = place[0], py = place[1], pz = place[2];
    const Array<Value>&low_x = low_[0], &low_y = low_[1], &low_z = low_[2];
    const Array<Value>&high_x = high_[0], &high_y = high_[1], &high_z = high_[2];
    for (int64_t i = first; i < last; ++i) {
      const Value x = std::max(std::max(low_x[i] - px, px - high_x[i]), Value{0});
      const Value y = std::max(std::max(low_y[i] - py, py - high_y[i]), Value{0});
      const Value z = std::max(std::max(low_z[i] - pz, pz - high_z[i]), Value{0});
      gap[i - first] = (x * x + y * y) + z * z;
    }
  }

  static Box<Value> box_of(const Point* from, const Point* to) {
    Box<Value> box;
    for (int d = 0; d < 3; ++d) box.low[d] = box.high[d] = from->at[d];
    for (const Point* point = from + 1; point < to; ++point) {
      for (int d = 0; d < 3; ++d) {
        box.low[d] = std::min(box.low[d], point->at[d]);
        box.high[d] = std::max(box.high[d], point->at[d]);
      }
    }
    return box;
  }

  void fill(int64_t number, const Point* from, const Point* to, const Box<Value>& box) {
    Leaf& leaf = leaves_[number];
    for (int d = 0; d < 3; ++d) low_[d][number] = box.low[d], high_[d][number] = box.high[d];
    for (const Point* point = from; point < to; ++point) {
      for (int d = 0; d < 3; ++d) leaf.at[d][point - from] = point->at[d];
      leaf.index[point - from] = point->index;
    }
  }

  int64_t num_points_, num_leaves_;
  Array<Leaf> leaves_;
  Array<Value> low_[3], high_[3];  // corners of the boxes of leaves
  Array<Box<Value>> boxes_;
  Array<int64_t> middles_;  // of each node, the first leaf of its second part
};

}  // namespace torchjoint
