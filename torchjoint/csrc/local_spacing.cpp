// The mean distance of points to their nearest neighbours, where it is neither small nor large. Leaves along a curve
// through space (Z-order) are made in a tenth of the time of a balanced tree; most of them need no search.
#include "array.h"
#include "common.h"

#include <array>
#include <cmath>
#include <numeric>

namespace torchjoint {
namespace {

constexpr int64_t kLeavesAtOnce = 64, kBeside = 1, kMostNeighbors = 8;
constexpr double kMostly = 1.5;
// Factor for limits, larger than their rounding errors.
constexpr double kSlack = 1 + 1e-9;

// Points, each with its own reach, in leaves, and the leaves around a leaf.
class Leaves {
 public:
  static constexpr int64_t kLeafSize = 16;

  Leaves(const float* points, const double* reach, int64_t count)
      : squared_reach((count + kLeafSize - 1) / kLeafSize * kLeafSize), least(squared_reach.size() / kLeafSize),
        count_(count), leaves_(least.size()), boxes_(least.size()) {
    if (count == 0) return;
    const std::vector<int32_t> order = order_along_curve(points, count);
    parallel_for_each(num_leaves(), 256,
                      [&](int64_t leaf) { fill(leaf, points, reach, order.data() + leaf * kLeafSize); });
    std::vector<Box> boxes(boxes_.data(), boxes_.data() + num_leaves());
    while (levels_.empty() || boxes.size() > 1) boxes = add_level(boxes);
  }

  int64_t num_leaves() const { return static_cast<int64_t>(leaves_.size()); }
  int64_t size(int64_t leaf) const { return std::min(kLeafSize, count_ - leaf * kLeafSize); }
  // The number, in the input, of a leaf's point.
  int32_t index(int64_t leaf, int64_t i) const { return leaves_[leaf].index[i]; }

  // The leaves, ascending, whose boxes are at most sqrt(limit) from that of a leaf.
  void around(int64_t leaf, double limit, std::vector<int32_t>& found) const {
    found.clear();
    visit(levels_.size() - 1, 0, boxes_[leaf], limit, found);
  }

  // Squared distances of a leaf's point to all points of another leaf.
  void measure(int64_t a, int64_t i, int64_t b, double* squared) const {
    const Leaf &one = leaves_[a], &other = leaves_[b];
    const double px = one.at[0][i], py = one.at[1][i], pz = one.at[2][i];
    for (int64_t j = 0; j < kLeafSize; ++j) {
      const double x = other.at[0][j] - px, y = other.at[1][j] - py, z = other.at[2][j] - pz;
      squared[j] = (x * x + y * y) + z * z;
    }
  }

  // The squared diagonal of a leaf's box. It is rounded as distances are, so no two points are farther apart.
  double farthest(int64_t leaf) const {
    const Box& box = boxes_[leaf];
    double part[3];
    for (int d = 0; d < 3; ++d) part[d] = double{box.high[d]} - box.low[d];
    return (part[0] * part[0] + part[1] * part[1]) + part[2] * part[2];
  }

  Array<double> squared_reach;  // by leaf
  Array<double> least;  // of the leaves' points

 private:
  static constexpr int64_t kChildren = 8;
  static constexpr int kCurveBits = 21;  // of each coordinate

  struct Box {
    float low[3], high[3];
  };
  struct Leaf {
    float at[3][kLeafSize];
    int32_t index[kLeafSize];
  };
  // The boxes of the children of a node; those that do not exist are infinitely far away.
  struct Node {
    float low[3][kChildren], high[3][kChildren];
  };

  // Puts two zeros between the bits of a number.
  static uint64_t spread(uint64_t bits) {
    bits = (bits | bits << 32) & 0x001F00000000FFFF;
    bits = (bits | bits << 16) & 0x001F0000FF0000FF;
    bits = (bits | bits << 8) & 0x100F00F00F00F00F;
    bits = (bits | bits << 4) & 0x10C30C30C30C30C3;
    return (bits | bits << 2) & 0x1249249249249249;
  }

  static std::vector<int32_t> order_along_curve(const float* points, int64_t count) {
    double low[3], extent = 0;
    for (int d = 0; d < 3; ++d) {
      float least = points[d], most = points[d];
      for (int64_t i = 1; i < count; ++i) {
        least = std::min(least, points[3 * i + d]), most = std::max(most, points[3 * i + d]);
      }
      low[d] = least, extent = std::max(extent, double{most} - least);
    }
    const double scale = extent > 0 ? ((1 << kCurveBits) - 1) / extent : 0;
    std::vector<uint64_t> code(count);
    for (int64_t i = 0; i < count; ++i) {
      for (int d = 0; d < 3; ++d) {
        code[i] |= spread(static_cast<uint64_t>((points[3 * i + d] - low[d]) * scale)) << d;
      }
    }
    return sorted(code);
  }

  // The order of codes, by their digits of 11 bits from the last to the first.
  static std::vector<int32_t> sorted(const std::vector<uint64_t>& code) {
    constexpr int kDigit = 11;
    std::vector<int32_t> order(code.size()), next(code.size());
    std::iota(order.begin(), order.end(), 0);
    for (int shift = 0; shift < 3 * kCurveBits; shift += kDigit) {
      const auto digit = [&](int32_t i) { return code[i] >> shift & ((1 << kDigit) - 1); };
      std::array<int32_t, (1 << kDigit) + 1> start{};
      for (const int32_t i : order) ++start[digit(i) + 1];
      std::partial_sum(start.begin(), start.end(), start.begin());
      for (const int32_t i : order) next[start[digit(i)]++] = i;
      order.swap(next);
    }
    return order;
  }

  void fill(int64_t number, const float* points, const double* reach, const int32_t* order) {
    Leaf& leaf = leaves_[number];
    Box& box = boxes_[number];
    const int64_t last = size(number) - 1;
    for (int64_t i = 0; i < kLeafSize; ++i) {  // beyond the last point, this one is repeated
      const int32_t point = leaf.index[i] = order[std::min(i, last)];
      const double own = reach[point], squared = own * own;
      squared_reach[number * kLeafSize + i] = squared;
      least[number] = i ? std::min(least[number], squared) : squared;
      for (int d = 0; d < 3; ++d) {
        const float at = leaf.at[d][i] = points[3 * int64_t{point} + d];
        box.low[d] = i ? std::min(box.low[d], at) : at;
        box.high[d] = i ? std::max(box.high[d], at) : at;
      }
    }
  }

  // Adds the nodes over some boxes; returns their boxes.
  std::vector<Box> add_level(const std::vector<Box>& boxes) {
    constexpr float inf = std::numeric_limits<float>::infinity();
    const size_t count = (boxes.size() + kChildren - 1) / kChildren;
    std::vector<Node>& nodes = levels_.emplace_back(count);
    std::vector<Box> all(count, {{inf, inf, inf}, {-inf, -inf, -inf}});
    for (size_t i = 0; i < count * kChildren; ++i) {
      const size_t node = i / kChildren, child = i % kChildren;
      for (int d = 0; d < 3; ++d) {
        const float low = i < boxes.size() ? boxes[i].low[d] : inf, high = i < boxes.size() ? boxes[i].high[d] : -inf;
        nodes[node].low[d][child] = low, nodes[node].high[d][child] = high;
        all[node].low[d] = std::min(all[node].low[d], low), all[node].high[d] = std::max(all[node].high[d], high);
      }
    }
    return all;
  }

  void visit(size_t level, size_t number, const Box& box, double limit, std::vector<int32_t>& found) const {
    const Node& node = levels_[level][number];
    double squared[kChildren] = {};
    for (int d = 0; d < 3; ++d) {
      for (int64_t child = 0; child < kChildren; ++child) {
        const double over = double{node.low[d][child]} - box.high[d], under = double{box.low[d]} - node.high[d][child];
        const double gap = std::max(std::max(over, under), 0.0);
        squared[child] += gap * gap;
      }
    }
    for (int64_t child = 0; child < kChildren; ++child) {
      if (!(squared[child] <= limit)) continue;
      const size_t below = number * kChildren + child;
      if (level > 0) {
        visit(level - 1, below, box, limit, found);
      } else {
        found.push_back(static_cast<int32_t>(below));
      }
    }
  }

  const int64_t count_;
  Array<Leaf> leaves_;
  Array<Box> boxes_;
  std::vector<std::vector<Node>> levels_;  // from the one over the leaves to the root
};

class Spacing {
 public:
  Spacing(const Leaves& leaves, double share, int64_t count, double* found)
      : leaves_(leaves), share_(share), count_(count), found_(found) {}

  void measure(int64_t leaf) {
    const int64_t size = leaves_.size(leaf);
    if (size > count_ && leaves_.farthest(leaf) * kSlack <= share_ * share_ * leaves_.least[leaf]) {
      for (int64_t i = 0; i < size; ++i) found_[leaves_.index(leaf, i)] = 0;
      return;
    }
    near_.clear();
    for (int64_t other = std::max<int64_t>(leaf - kBeside, 0);
         other <= std::min(leaf + kBeside, leaves_.num_leaves() - 1); ++other) {
      near_.push_back(static_cast<int32_t>(other));
    }
    int64_t left[Leaves::kLeafSize];
    std::iota(left, left + size, 0);
    int64_t num_left = measure_points(leaf, 0, left, size);
    // If the mean distance is within reach, all distances are within `count` times the reach; mostly within fewer.
    for (const double factor : {std::min(kMostly, static_cast<double>(count_)), static_cast<double>(count_)}) {
      if (num_left == 0) return;
      double largest = 0;
      for (int64_t i = 0; i < num_left; ++i) largest = std::max(largest, squared_reach(leaf, left[i]));
      leaves_.around(leaf, factor * factor * largest * kSlack, near_);
      num_left = measure_points(leaf, factor, left, num_left);
    }
  }

 private:
  double squared_reach(int64_t leaf, int64_t i) const { return leaves_.squared_reach[leaf * Leaves::kLeafSize + i]; }

  // Measures some points among the near leaves, which have all points within `factor` times the reach. Keeps those that
  // may have nearer neighbours elsewhere; returns their number.
  int64_t measure_points(int64_t leaf, double factor, int64_t* points, int64_t count) {
    int64_t kept = 0;
    for (int64_t i = 0; i < count; ++i) {
      double farthest;
      const double mean = found_[leaves_.index(leaf, points[i])] = mean_distance(leaf, points[i], farthest);
      if (mean > 0 && farthest > factor * factor * squared_reach(leaf, points[i])) points[kept++] = points[i];
    }
    return kept;
  }

  // Whether a point has enough others within the share of its reach, by a fast test.
  bool has_enough(int64_t leaf, int64_t i) const {
    const double limit = share_ * share_ * squared_reach(leaf, i) / kSlack;
    int64_t found = -1;  // not the point itself
    for (const int32_t other : near_) {
      double squared[Leaves::kLeafSize];
      leaves_.measure(leaf, i, other, squared);
      for (int64_t j = 0; j < Leaves::kLeafSize; ++j) found += j < leaves_.size(other) && squared[j] <= limit;
      if (found >= count_) return true;
    }
    return false;
  }

  // The mean distance to the nearest points in the near leaves: 0 if it is small, infinite beyond the point's reach.
  // Also gives the largest of these distances, squared.
  double mean_distance(int64_t leaf, int64_t i, double& farthest) const {
    constexpr double inf = std::numeric_limits<double>::infinity();
    if (has_enough(leaf, i)) return 0;
    const double reach = std::sqrt(squared_reach(leaf, i));
    double nearest[kMostNeighbors];
    std::fill_n(nearest, count_, inf);
    double mean = inf;
    for (const int32_t other : near_) {
      double squared[Leaves::kLeafSize];
      leaves_.measure(leaf, i, other, squared);
      if (other == leaf) squared[i] = inf;
      bool changed = false;
      for (int64_t j = 0; j < leaves_.size(other); ++j) {
        double value = squared[j];
        if (!(value < nearest[count_ - 1])) continue;
        changed = true;
        for (int64_t k = 0; k < count_; ++k) {
          if (value < nearest[k]) std::swap(value, nearest[k]);
        }
      }
      if (!changed) continue;
      double sum = 0;
      for (int64_t k = 0; k < count_; ++k) sum += std::sqrt(nearest[k]);
      mean = sum / static_cast<double>(count_);
      if (mean <= share_ * reach) return 0;
    }
    farthest = nearest[count_ - 1];
    return mean <= reach ? mean : inf;
  }

  const Leaves& leaves_;
  const double share_;
  const int64_t count_;
  double* const found_;
  std::vector<int32_t> near_;
};

Tensor local_spacing(const Tensor& points, const Tensor& reach, double share, int64_t count) {
  const Tensor places = checked_array(points, ScalarType::Float, {-1, 3}, "points");
  const int64_t num_points = places.size(0);
  check(num_points <= kMaxCount, "points: expected at most 2^31 - 1 points, got ", num_points);
  const Tensor reaches = checked_array(reach, ScalarType::Double, {num_points}, "reach");
  check(share >= 0 && share <= 1, "share: expected a number in [0, 1], got ", share);
  check(count >= 1 && count <= kMostNeighbors, "count: expected a number in [1, ", kMostNeighbors, "], got ", count);
  const float* const at = places.const_data_ptr<float>();
  for (int64_t i = 0; i < 3 * num_points; ++i) {
    check(std::isfinite(at[i]), "points: expected finite coordinates, got ", at[i], " in row ", i / 3);
  }
  const double* const own = reaches.const_data_ptr<double>();
  for (int64_t i = 0; i < num_points; ++i) {
    check(own[i] >= 0 && std::isfinite(own[i]), "reach: expected finite numbers >= 0, got ", own[i], " at ", i);
  }
  const Leaves leaves(at, own, num_points);
  Tensor found = torch::stable::new_empty(places, {num_points}, ScalarType::Double);
  double* const spacing = found.mutable_data_ptr<double>();
  torch::stable::parallel_for(0, leaves.num_leaves(), kLeavesAtOnce, [&](int64_t begin, int64_t end) {
    Spacing of_leaves(leaves, share, count, spacing);
    run_fastest([&] {
      for (int64_t leaf = begin; leaf < end; ++leaf) of_leaves.measure(leaf);
    });
  });
  return found;
}

}  // namespace

TORCHJOINT_OPERATOR(local_spacing, "(Tensor points, Tensor reach, float share, int count) -> Tensor");

}  // namespace torchjoint
