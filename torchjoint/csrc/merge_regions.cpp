// Region merging by mean boundary cost (average linkage): see region_graph.h.
//
// Two regions merge only if an edge between them costs at most the threshold. So the connected parts of the graph of
// such edges are independent: each is a small graph, which fits in the processor's cache, and several of them are merged
// in parallel.
#include "array.h"
#include "merged_regions.h"

#include <algorithm>
#include <numeric>
#include <vector>

namespace torchjoint {
namespace {

// Connected parts are merged as one graph until it has so many edges. This number does not change the result.
constexpr int64_t kEdgesPerBlock = 1 << 14;

// Things in blocks: those of block b are member[start[b]] ... member[start[b + 1] - 1], in their own order.
struct Blocks {
  template <typename BlockOf>
  Blocks(int64_t num_things, int64_t num_blocks, const BlockOf& block_of) : start(num_blocks + 1, 0) {
    for (int64_t i = 0; i < num_things; ++i) {
      if (const int64_t block = block_of(i); block >= 0) ++start[block + 1];
    }
    std::partial_sum(start.begin(), start.end(), start.begin());
    member = Array<int32_t>(start.back());
    std::vector<int64_t> next(start.begin(), start.end() - 1);
    for (int64_t i = 0; i < num_things; ++i) {
      if (const int64_t block = block_of(i); block >= 0) member[next[block]++] = static_cast<int32_t>(i);
    }
  }

  std::vector<int64_t> start;
  Array<int32_t> member{0};
};

class Merging {
 public:
  Merging(const int64_t* edges, const float* cost, int64_t num_edges, const Tensor& sizes)
      : edges_(edges), num_edges_(num_edges), num_regions_(sizes.size(0)), cost_(num_edges),
        merged_(sizes.const_data_ptr<int64_t>(), num_regions_) {
    for (int64_t e = 0; e < num_edges; ++e) {
      cost_[e] = static_cast<int32_t>(checked_cost(edges, cost, num_edges, num_regions_, e));
    }
  }

  void merge_up_to(double threshold) {
    const std::vector<int32_t> block = blocks_of_regions(threshold);
    const int64_t num_blocks = block.empty() ? 0 : 1 + *std::max_element(block.begin(), block.end());
    const Blocks regions(num_regions_, num_blocks, [&](int64_t region) { return block[region]; });
    const Blocks inside(num_edges_, num_blocks, [&](int64_t e) {
      return first(e) != second(e) && part_[first(e)] == part_[second(e)] ? block[first(e)] : kNone;
    });
    std::vector<int32_t> number(num_regions_);  // in the block
    torch::stable::parallel_for(0, num_blocks, 1, [&](int64_t begin, int64_t end) {
      for (int64_t b = begin; b < end; ++b) {
        const int32_t* const region = regions.member.data() + regions.start[b];
        const int64_t num_inside = regions.start[b + 1] - regions.start[b];
        for (int64_t i = 0; i < num_inside; ++i) number[region[i]] = static_cast<int32_t>(i);
        RegionAdjacencyGraph graph(num_inside);
        for (int64_t i = inside.start[b]; i < inside.start[b + 1]; ++i) {
          const int64_t e = inside.member[i];
          graph.add(number[first(e)], number[second(e)], cost_[e]);
        }
        // No other block contains these regions.
        graph.merge_weakest([&](const RegionBoundary& border) { return border.mean() <= threshold; },
                            [&](int32_t n) { join(graph.border(n), region); });
      }
    });
  }

  // Merges the regions of fewer than `min_size` points. Boundaries between two larger regions are never merged.
  void join_small(int64_t min_size) {
    std::vector<int32_t> group(num_regions_), root;
    for (int64_t region = 0; region < num_regions_; ++region) {  // the root of a group is its lowest region
      const int32_t lowest = merged_.find(static_cast<int32_t>(region));
      if (lowest == region) root.push_back(lowest);
      group[region] = lowest == region ? static_cast<int32_t>(root.size() - 1) : group[lowest];
    }
    const int64_t num_groups = static_cast<int64_t>(root.size());
    std::vector<uint8_t> small(num_groups);
    for (int64_t g = 0; g < num_groups; ++g) small[g] = merged_.size(root[g]) < min_size;
    const auto is_small = [&](const RegionBoundary& border) {
      return small[border.region[0]] || small[border.region[1]];
    };
    RegionAdjacencyGraph graph(num_groups);
    for (int64_t e = 0; e < num_edges_; ++e) {
      const int32_t a = group[first(e)], b = group[second(e)];
      if (a != b && (small[a] || small[b])) graph.add(a, b, cost_[e]);
    }
    graph.merge_weakest(is_small, [&](int32_t n) {
      const auto [a, b] = graph.border(n).region;
      join(graph.border(n), root.data());
      small[a] = small[b] = merged_.size(root[a]) < min_size;  // the merged region keeps one of both numbers
    });
  }

  // Numbers the groups by their first regions.
  void label(int64_t* labels) {
    int64_t next = 0;
    for (int64_t region = 0; region < num_regions_; ++region) {
      const int32_t lowest = merged_.find(static_cast<int32_t>(region));
      labels[region] = lowest == region ? next++ : labels[lowest];
    }
  }

 private:
  int64_t first(int64_t e) const { return edges_[e]; }
  int64_t second(int64_t e) const { return edges_[num_edges_ + e]; }

  void join(const RegionBoundary& border, const int32_t* region) {
    merged_.join(region[border.region[0]], region[border.region[1]]);
  }

  // Finds the connected parts, and returns the block of each region; a part is in one block.
  std::vector<int32_t> blocks_of_regions(double threshold) {
    const std::vector<int64_t> no_size(num_regions_, 0);
    Merged parts(no_size.data(), num_regions_);
    for (int64_t e = 0; e < num_edges_; ++e) {
      if (cost_[e] <= threshold) parts.join(static_cast<int32_t>(first(e)), static_cast<int32_t>(second(e)));
    }
    part_.resize(num_regions_);
    for (int64_t region = 0; region < num_regions_; ++region) part_[region] = parts.find(static_cast<int32_t>(region));
    std::vector<int64_t> num_inside(num_regions_, 0);  // edges of each part, at its lowest region
    for (int64_t e = 0; e < num_edges_; ++e) {
      if (part_[first(e)] == part_[second(e)]) ++num_inside[part_[first(e)]];
    }
    std::vector<int32_t> block(num_regions_, kNone);
    int32_t current = 0;
    int64_t edges = 0;
    for (int64_t region = 0; region < num_regions_; ++region) {
      if (part_[region] != region) {
        block[region] = block[part_[region]];
      } else if (num_inside[region] > 0) {
        if (edges > 0 && edges + num_inside[region] > kEdgesPerBlock) ++current, edges = 0;
        edges += num_inside[region];
        block[region] = current;
      }
    }
    return block;
  }

  const int64_t* edges_;
  int64_t num_edges_, num_regions_;
  Array<int32_t> cost_;
  Merged merged_;
  std::vector<int32_t> part_;  // of each region: the lowest region of its connected part
};

Tensor merge_regions(const Tensor& edge_index, const Tensor& cost, const Tensor& size, double threshold,
                     int64_t min_size) {
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
  merging.merge_up_to(threshold * kUnit);
  if (min_size > 0) merging.join_small(min_size);
  Tensor labels = torch::stable::new_empty(sizes, {num_regions}, ScalarType::Long);
  merging.label(labels.mutable_data_ptr<int64_t>());
  return labels;
}

}  // namespace

TORCHJOINT_OPERATOR(merge_regions,
                    "(Tensor edge_index, Tensor cost, Tensor size, float threshold, int min_size) -> Tensor");

}  // namespace torchjoint
