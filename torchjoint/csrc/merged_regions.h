// Shared by the operators that merge regions: the unit of costs, the graph of regions, and the merged regions.
#pragma once

#include <cmath>
#include <cstdint>
#include <numeric>
#include <utility>
#include <vector>

#include "common.h"
#include "region_graph.h"

namespace torchjoint {

// Costs are multiplied by this and rounded to whole numbers, so that sums are exact in any order.
constexpr double kUnit = 1 << 20;
constexpr float kLargestCost = 1 << 10;

// Checks edge e, and returns its cost as a whole number.
inline double checked_cost(const int64_t* edges, const float* cost, int64_t num_edges, int64_t num_regions, int64_t e) {
  check_ends(edges[e], edges[num_edges + e], num_regions, e);
  check(cost[e] >= 0 && cost[e] <= kLargestCost, "cost: expected numbers in [0, ", kLargestCost, "], got ", cost[e],
        " at edge ", e);
  return std::nearbyint(cost[e] * kUnit);
}

// How many parallel edges each of E edges stands for.
inline Tensor checked_counts(const Tensor& count, int64_t num_edges) {
  const Tensor counts = checked_array(count, ScalarType::Long, {num_edges}, "count");
  for (int64_t e = 0; e < num_edges; ++e) {
    const int64_t got = counts.const_data_ptr<int64_t>()[e];
    check(got > 0 && got <= kMaxCount, "count: expected numbers in [1, 2^31 - 1], got ", got, " at edge ", e);
  }
  return counts;
}

// Union-find of the merged regions, with their sizes. The root of a group is its lowest region.
class Merged {
 public:
  Merged(const int64_t* size, int64_t num_regions) : parent_(num_regions), size_(size, size + num_regions) {
    std::iota(parent_.begin(), parent_.end(), 0);
  }

  int32_t find(int32_t region) {
    while (parent_[region] != region) region = parent_[region] = parent_[parent_[region]];
    return region;
  }

  int64_t size(int32_t region) { return size_[find(region)]; }

  void join(int32_t a, int32_t b) {
    a = find(a), b = find(b);
    if (a == b) return;
    if (b < a) std::swap(a, b);
    size_[a] += size_[b];
    parent_[b] = a;
  }

 private:
  std::vector<int32_t> parent_;
  std::vector<int64_t> size_;
};

}  // namespace torchjoint
