// Lists the merges of region merging by mean boundary cost, in order: see region_graph.h.
#include "merged_regions.h"

#include <tuple>

namespace torchjoint {
namespace {

std::tuple<Tensor, Tensor> region_dendrogram(const Tensor& edge_index, const Tensor& cost, int64_t num_regions,
                                             double threshold, const Tensor& count) {
  const Tensor edges = checked_edge_index(edge_index);
  const int64_t num_edges = edges.size(1);
  const Tensor costs = checked_array(cost, ScalarType::Float, {num_edges}, "cost");
  check(num_regions >= 0 && num_regions <= kMaxCount, "num_regions: expected 0 to 2^31 - 1, got ", num_regions);
  check(threshold >= 0, "threshold: expected a number >= 0, got ", threshold);

  const Tensor counts = checked_counts(count, num_edges);
  const int64_t* const end = edges.const_data_ptr<int64_t>();
  RegionAdjacencyGraph graph(num_regions);
  for (int64_t e = 0; e < num_edges; ++e) {
    const double whole = checked_cost(end, costs.const_data_ptr<float>(), num_edges, num_regions, e);
    const int32_t a = static_cast<int32_t>(end[e]), b = static_cast<int32_t>(end[num_edges + e]);
    if (a != b) graph.add(a, b, whole, counts.const_data_ptr<int64_t>()[e]);
  }
  const std::vector<int64_t> points(num_regions, 1);
  Merged merged(points.data(), num_regions);
  std::vector<int64_t> lower, higher;
  std::vector<double> mean;
  graph.merge_weakest([&](const RegionBoundary& border) { return border.mean() <= threshold * kUnit; },
                      [&](int32_t number) {
                        const RegionBoundary& border = graph.border(number);
                        const int32_t a = merged.find(border.region[0]), b = merged.find(border.region[1]);
                        lower.push_back(std::min(a, b));
                        higher.push_back(std::max(a, b));
                        mean.push_back(border.mean() / kUnit);
                        merged.join(a, b);
                        return true;
                      });

  return {to_pairs(lower, higher, edges), to_tensor(mean, ScalarType::Double, edges)};
}

}  // namespace

TORCHJOINT_OPERATOR(region_dendrogram,
                    "(Tensor edge_index, Tensor cost, int num_regions, float threshold, Tensor count) -> (Tensor, "
                    "Tensor)");

}  // namespace torchjoint
