// Region merging by mean boundary cost (average linkage): see region_graph.h.
//
// Regions with near numbers are mostly near in space. So blocks of successive regions are merged first, each by itself:
// such a graph fits in the processor's cache, and several are merged in parallel. Two regions merge where their boundary
// is the weakest one around both. No other merge, in whatever order, can make another boundary around them weaker. So
// the groups are the same as if the weakest boundary of all regions were merged first.
#include "array.h"
#include "merged_regions.h"

#include <algorithm>
#include <limits>
#include <numeric>
#include <vector>

namespace torchjoint {
namespace {

// This number does not change the result.
constexpr int64_t kRegionsPerBlock = 1 << 13;

class Merging {
 public:
  Merging(const int64_t* edges, const float* cost, int64_t num_edges, const Tensor& sizes)
      : edges_(edges), num_edges_(num_edges), num_regions_(sizes.size(0)), cost_(num_edges),
        merged_(sizes.const_data_ptr<int64_t>(), num_regions_) {
    for (int64_t e = 0; e < num_edges; ++e) {
      cost_[e] = static_cast<int32_t>(checked_cost(edges, cost, num_edges, num_regions_, e));
    }
  }

  // `by_size`: by the mean cost times a b / (a + b), where a and b are the sizes (0 if both are 0), as in Ward's criterion.
  void merge_up_to(double threshold, bool by_size) {
    const std::vector<int32_t> part = connected_parts(by_size ? std::numeric_limits<double>::infinity() : threshold);
    const auto may_meet = [&](int64_t e) { return first(e) != second(e) && part[first(e)] == part[second(e)]; };
    if (!by_size) merge_blocks(threshold, may_meet);
    const Groups groups = current_groups();
    RegionAdjacencyGraph graph(groups.root.size());
    for (int64_t e = 0; e < num_edges_; ++e) {
      const int32_t a = groups.of_region[first(e)], b = groups.of_region[second(e)];
      if (a != b && may_meet(e)) graph.add(a, b, cost_[e]);
    }
    const auto size = [&](int32_t group) { return static_cast<double>(merged_.size(groups.root[group])); };
    const auto cost = [&](const RegionBoundary& border) {
      if (!by_size) return border.mean();
      const double a = size(border.region[0]), b = size(border.region[1]);
      return border.mean() * (a * b / std::max(a + b, 1.0));
    };
    graph.merge_weakest([&](const RegionBoundary& border) { return cost(border) <= threshold; },
                        [&](int32_t n) { return join(graph.border(n), groups.root.data()); }, cost);
  }

  // Merges the regions of fewer than `min_size` points. Boundaries between two larger regions are never merged.
  void join_small(int64_t min_size) {
    const auto [group, root] = current_groups();
    std::vector<uint8_t> small(root.size());
    for (size_t g = 0; g < root.size(); ++g) small[g] = merged_.size(root[g]) < min_size;
    RegionAdjacencyGraph graph(root.size());
    for (int64_t e = 0; e < num_edges_; ++e) {
      const int32_t a = group[first(e)], b = group[second(e)];
      if (a != b && (small[a] || small[b])) graph.add(a, b, cost_[e]);
    }
    const auto is_small = [&](const RegionBoundary& border) {
      return small[border.region[0]] || small[border.region[1]];
    };
    graph.merge_weakest(is_small, [&](int32_t n) {
      const auto [a, b] = graph.border(n).region;
      join(graph.border(n), root.data());
      small[a] = small[b] = merged_.size(root[a]) < min_size;  // the merged region keeps one of both numbers
      return true;
    });
  }

  // Groups are numbered by their first regions.
  struct Groups {
    std::vector<int32_t> of_region, root;  // the root of a group is its lowest region
  };

  Groups current_groups() {
    Groups groups{std::vector<int32_t>(num_regions_), {}};
    for (int64_t region = 0; region < num_regions_; ++region) {
      const int32_t lowest = merged_.find(static_cast<int32_t>(region));
      if (lowest == region) groups.root.push_back(lowest);
      groups.of_region[region] =
          lowest == region ? static_cast<int32_t>(groups.root.size() - 1) : groups.of_region[lowest];
    }
    return groups;
  }

 private:
  int64_t first(int64_t e) const { return edges_[e]; }
  int64_t second(int64_t e) const { return edges_[num_edges_ + e]; }

  bool join(const RegionBoundary& border, const int32_t* region) {
    merged_.join(region[border.region[0]], region[border.region[1]]);
    return true;
  }

  // For each region the lowest region of its connected part. Only an edge that costs at most the threshold connects.
  std::vector<int32_t> connected_parts(double threshold) const {
    const std::vector<int64_t> no_size(num_regions_, 0);
    Merged parts(no_size.data(), num_regions_);
    for (int64_t e = 0; e < num_edges_; ++e) {
      if (cost_[e] <= threshold) parts.join(static_cast<int32_t>(first(e)), static_cast<int32_t>(second(e)));
    }
    std::vector<int32_t> part(num_regions_);
    for (int64_t region = 0; region < num_regions_; ++region) part[region] = parts.find(static_cast<int32_t>(region));
    return part;
  }

  // Merges each block as far as no edge to another block is weaker.
  template <typename MayMeet>
  void merge_blocks(double threshold, const MayMeet& may_meet) {
    const int64_t num_blocks = (num_regions_ + kRegionsPerBlock - 1) / kRegionsPerBlock;
    // The lowest cost of the edges between each region and other blocks.
    std::vector<int32_t> limit(num_regions_, std::numeric_limits<int32_t>::max());
    const auto block_of = [&](int64_t e) -> int64_t {
      const int64_t a = first(e), b = second(e), block = a / kRegionsPerBlock;
      if (!may_meet(e)) return kNone;
      if (block == b / kRegionsPerBlock) return block;
      limit[a] = std::min(limit[a], cost_[e]), limit[b] = std::min(limit[b], cost_[e]);
      return kNone;
    };
    // The edges inside block b are inside[start[b]] ... inside[start[b + 1] - 1], in their own order.
    std::vector<int64_t> start(num_blocks + 1, 0);
    for (int64_t e = 0; e < num_edges_; ++e) {
      if (const int64_t block = block_of(e); block != kNone) ++start[block + 1];
    }
    std::partial_sum(start.begin(), start.end(), start.begin());
    Array<int32_t> inside(start.back());
    std::vector<int64_t> next(start.begin(), start.end() - 1);
    for (int64_t e = 0; e < num_edges_; ++e) {
      if (const int64_t block = block_of(e); block != kNone) inside[next[block]++] = static_cast<int32_t>(e);
    }
    torch::stable::parallel_for(0, num_blocks, 1, [&](int64_t begin, int64_t end) {
      for (int64_t b = begin; b < end; ++b) {
        const int64_t lowest = b * kRegionsPerBlock;
        RegionAdjacencyGraph graph(std::min(kRegionsPerBlock, num_regions_ - lowest));
        for (int64_t i = start[b]; i < start[b + 1]; ++i) {
          const int64_t e = inside[i];
          graph.add(static_cast<int32_t>(first(e) - lowest), static_cast<int32_t>(second(e) - lowest), cost_[e]);
        }
        const auto may_merge = [&](const RegionBoundary& border) { return border.mean() <= threshold; };
        graph.merge_weakest(may_merge, [&](int32_t n) {
          const RegionBoundary& border = graph.border(n);
          const int64_t one = lowest + border.region[0], other = lowest + border.region[1];
          // The merged region keeps one of both numbers. If they do not merge, neither may merge with a third one.
          limit[one] = limit[other] = std::min(limit[one], limit[other]);
          if (limit[one] <= border.mean()) return false;
          merged_.join(static_cast<int32_t>(one), static_cast<int32_t>(other));
          return true;
        });
      }
    });
  }

  const int64_t* edges_;
  int64_t num_edges_, num_regions_;
  Array<int32_t> cost_;
  Merged merged_;
};

Tensor merge_regions(const Tensor& edge_index, const Tensor& cost, const Tensor& size, double threshold,
                     int64_t min_size, bool by_size) {
  const Tensor edges = checked_edge_index(edge_index);
  const int64_t num_edges = edges.size(1);
  const Tensor costs = checked_array(cost, ScalarType::Float, {num_edges}, "cost");
  const Tensor sizes = checked_array(size, ScalarType::Long, {-1}, "size");
  const int64_t num_regions = sizes.size(0);
  check(num_regions <= kMaxCount, "size: expected at most 2^31 - 1 regions, got ", num_regions);
  for (int64_t region = 0; region < num_regions; ++region) {
    const int64_t got = sizes.const_data_ptr<int64_t>()[region];
    check(got >= 0, "size: expected numbers >= 0, got ", got, " at ", region);
  }
  check(threshold >= 0, "threshold: expected a number >= 0, got ", threshold);
  check(min_size >= 0, "min_size: expected a number >= 0, got ", min_size);

  Merging merging(edges.const_data_ptr<int64_t>(), costs.const_data_ptr<float>(), num_edges, sizes);
  merging.merge_up_to(threshold * kUnit, by_size);
  if (min_size > 0) merging.join_small(min_size);
  Tensor labels = torch::stable::new_empty(sizes, {num_regions}, ScalarType::Long);
  const std::vector<int32_t> group = merging.current_groups().of_region;
  std::copy(group.begin(), group.end(), labels.mutable_data_ptr<int64_t>());
  return labels;
}

}  // namespace

TORCHJOINT_OPERATOR(
    merge_regions,
    "(Tensor edge_index, Tensor cost, Tensor size, float threshold, int min_size, bool by_size) -> Tensor");

}  // namespace torchjoint
