// The operator connected_components: which nodes of a graph are connected by edges.
#include "common.h"
#include "union_find.h"

namespace torchjoint {
namespace {

Tensor connected_components(const Tensor& edge_index, int64_t num_nodes) {
  const Tensor edges = checked_edge_index(edge_index);
  check(num_nodes >= 0 && num_nodes <= kMaxCount, "num_nodes: expected 0 <= num_nodes < 2^31, got ", num_nodes);

  const int64_t num_edges = edges.size(1);
  const int64_t* const first = edges.const_data_ptr<int64_t>();
  const int64_t* const second = first + num_edges;
  UnionFind components(num_nodes);
  for (int64_t e = 0; e < num_edges; ++e) {
    check_ends(first[e], second[e], num_nodes, e);
    const int32_t a = components.find(static_cast<int32_t>(first[e]));
    const int32_t b = components.find(static_cast<int32_t>(second[e]));
    if (a != b) components.join(a, b);
  }
  Tensor labels = torch::stable::new_empty(edges, {num_nodes}, ScalarType::Long);
  components.write_labels(labels.mutable_data_ptr<int64_t>());
  return labels;
}

}  // namespace

TORCHJOINT_OPERATOR(connected_components, "(Tensor edge_index, SymInt num_nodes) -> Tensor");

}  // namespace torchjoint
