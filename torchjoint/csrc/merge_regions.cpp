// Region merging by mean boundary cost (average linkage): see region_graph.h.
#include "merged_regions.h"

namespace torchjoint {
namespace {

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

  RegionAdjacencyGraph graph = boundaries_of(edges.const_data_ptr<int64_t>(), costs.const_data_ptr<float>(), num_edges, num_regions);
  Merged merged(sizes.const_data_ptr<int64_t>(), num_regions);
  const auto join = [&](int32_t number) { merged.join(graph.border(number).region[0], graph.border(number).region[1]); };
  const auto is_small = [&](int32_t region) { return merged.size(region) < min_size; };
  graph.merge_weakest([&](const RegionBoundary& border) { return border.mean() <= threshold * kUnit; }, join);
  graph.merge_weakest([&](const RegionBoundary& border) { return is_small(border.region[0]) || is_small(border.region[1]); }, join);

  Tensor labels = torch::stable::new_empty(sizes, {num_regions}, ScalarType::Long);
  int64_t* const out = labels.mutable_data_ptr<int64_t>();
  std::vector<int64_t> number(num_regions, -1);
  int64_t next = 0;
  for (int64_t region = 0; region < num_regions; ++region) {
    int64_t& label = number[merged.find(static_cast<int32_t>(region))];
    if (label < 0) label = next++;
    out[region] = label;
  }
  return labels;
}

}  // namespace

STABLE_TORCH_LIBRARY_FRAGMENT(torchjoint, m) {
  m.def("merge_regions(Tensor edge_index, Tensor cost, Tensor size, float threshold, int min_size) -> Tensor");
}

STABLE_TORCH_LIBRARY_IMPL(torchjoint, CPU, m) {
  m.impl("merge_regions", TORCH_BOX(&merge_regions));
}

}  // namespace torchjoint
