// The sum of the leaf values that each row reaches in boosted decision trees.
#include "common.h"

#include <cmath>

namespace torchjoint {
namespace {

// Rows that are processed together, tree by tree, so that a tree stays in the cache. This number does not change the
// result.
constexpr int64_t kRowsPerBlock = 64;
// Rows that go down a tree at the same time. The path of a row is unpredictable, but no row waits for another.
constexpr int64_t kRowsAtOnce = 16;

// The value is the threshold of an inner node, or the value of a leaf. Both children of a leaf are the leaf itself.
struct Node {
  double value;
  int32_t feature;
  int32_t child[2];  // left, right
  bool missing_right;
};

struct Trees {
  Trees(const Tensor& feature, const Tensor& threshold, const Tensor& missing_left, const Tensor& left,
        const Tensor& right, const Tensor& leaf_value, int64_t num_features)
      : count(feature.size(0)), length(feature.size(1)) {
    const int32_t* features = feature.const_data_ptr<int32_t>();
    const double* thresholds = threshold.const_data_ptr<double>();
    const bool* missing = missing_left.const_data_ptr<bool>();
    const int32_t *lefts = left.const_data_ptr<int32_t>(), *rights = right.const_data_ptr<int32_t>();
    const double* values = leaf_value.const_data_ptr<double>();
    nodes.reserve(count * length);
    depth.reserve(count);
    std::vector<int32_t> depth_of_node(length);
    for (int64_t i = 0; i < count * length; ++i) {
      const int64_t tree = i / length, place = i % length;
      check(std::isfinite(thresholds[i]), "threshold: expected finite numbers, got ", thresholds[i], " at node ", place,
            " of tree ", tree);
      check(std::isfinite(values[i]), "leaf_value: expected finite numbers, got ", values[i], " at node ", place,
            " of tree ", tree);
      check(features[i] >= 0 && (features[i] < num_features || lefts[i] < 0), "feature: expected numbers in [0, ",
            num_features, "), got ", features[i], " at node ", place, " of tree ", tree);
      check_child(lefts[i], "left", place, tree);
      check_child(rights[i], "right", place, tree);
      check((lefts[i] < 0) == (rights[i] < 0), "right: expected -1 exactly where left is -1, got ", rights[i],
            " at node ", place, " of tree ", tree);
      if (place == 0) {
        std::fill(depth_of_node.begin(), depth_of_node.end(), 0);
        depth.push_back(0);
      }
      if (lefts[i] < 0) {
        const int32_t self = static_cast<int32_t>(place);
        nodes.push_back({values[i], 0, {self, self}, false});
      } else {
        nodes.push_back({thresholds[i], features[i], {lefts[i], rights[i]}, !missing[i]});
        const int32_t below = depth_of_node[place] + 1;
        for (const int32_t child : nodes.back().child) depth_of_node[child] = std::max(depth_of_node[child], below);
        depth.back() = std::max(depth.back(), below);
      }
    }
  }

  // A child comes after its parent, so there are no cycles.
  void check_child(int32_t child, const char* name, int64_t place, int64_t tree) const {
    check(child == -1 || (child > place && child < length), name, ": expected -1 or places after the node's, below ",
          length, ", got ", child, " at node ", place, " of tree ", tree);
  }

  // Adds the values of the leaves that kRows rows reach in one tree.
  template <int64_t kRows>
  void add_leaves(int64_t tree, const float* rows, int64_t num_features, double* sums) const {
    const Node* const root = nodes.data() + tree * length;
    int32_t at[kRows] = {};
    for (int32_t level = 0; level < depth[tree]; ++level) {
      for (int64_t i = 0; i < kRows; ++i) {
        const Node& node = root[at[i]];
        const double value = rows[i * num_features + node.feature];
        // All comparisons with a missing value, NaN, are false.
        at[i] = node.child[(value > node.value) | (std::isnan(value) & node.missing_right)];
      }
    }
    for (int64_t i = 0; i < kRows; ++i) sums[i] += root[at[i]].value;
  }

  int64_t count, length;
  std::vector<Node> nodes;
  std::vector<int32_t> depth;  // of each tree: the longest path from its root to a leaf
};

Tensor boosted_trees(const Tensor& values, const Tensor& feature, const Tensor& threshold, const Tensor& missing_left,
                     const Tensor& left, const Tensor& right, const Tensor& leaf_value) {
  const Tensor rows = checked_array(values, ScalarType::Float, {-1, -1}, "values");
  const int64_t num_rows = rows.size(0), num_features = rows.size(1);
  check(num_features <= kMaxCount, "values: expected at most 2^31 - 1 features, got ", num_features);
  const Tensor features = checked_array(feature, ScalarType::Int, {-1, -1}, "feature");
  const int64_t count = features.size(0), length = features.size(1);
  check(length >= 1 && length <= kMaxCount, "feature: expected 1 to 2^31 - 1 nodes in a tree, got ", length);
  const Tensor thresholds = checked_array(threshold, ScalarType::Double, {count, length}, "threshold");
  const Tensor missing = checked_array(missing_left, ScalarType::Bool, {count, length}, "missing_left");
  const Tensor lefts = checked_array(left, ScalarType::Int, {count, length}, "left");
  const Tensor rights = checked_array(right, ScalarType::Int, {count, length}, "right");
  const Tensor leaves = checked_array(leaf_value, ScalarType::Double, {count, length}, "leaf_value");
  const Trees trees(features, thresholds, missing, lefts, rights, leaves, num_features);

  Tensor result = torch::stable::new_empty(rows, {num_rows}, ScalarType::Double);
  const float* const data = rows.const_data_ptr<float>();
  double* const sums = result.mutable_data_ptr<double>();
  std::fill_n(sums, num_rows, 0.0);
  const int64_t blocks = (num_rows + kRowsPerBlock - 1) / kRowsPerBlock;
  parallel_for_each(blocks, 1, [&](int64_t block) {
    const int64_t first = block * kRowsPerBlock, last = std::min(first + kRowsPerBlock, num_rows);
    for (int64_t tree = 0; tree < trees.count; ++tree) {
      int64_t row = first;
      for (; row + kRowsAtOnce <= last; row += kRowsAtOnce) {
        trees.add_leaves<kRowsAtOnce>(tree, data + row * num_features, num_features, sums + row);
      }
      for (; row < last; ++row) trees.add_leaves<1>(tree, data + row * num_features, num_features, sums + row);
    }
  });
  return result;
}

}  // namespace

TORCHJOINT_OPERATOR(boosted_trees,
                    "(Tensor values, Tensor feature, Tensor threshold, Tensor missing_left, Tensor left, Tensor "
                    "right, Tensor leaf_value) -> Tensor");

}  // namespace torchjoint
