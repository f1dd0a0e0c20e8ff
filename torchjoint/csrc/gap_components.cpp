// Which points are connected over gaps: neighbours are, if neither allows a smaller gap than their distance. Small
// components then join others over larger gaps.
#include "neighbors.h"
#include "union_find.h"

#include <cmath>
#include <tuple>

namespace torchjoint {
namespace {

struct Edge {
  double weight;  // squared: of the distance, in gaps
  int32_t u, v;  // u < v

  bool operator<(const Edge& other) const { return std::tie(weight, u, v) < std::tie(other.weight, other.u, other.v); }
};

struct Points {
  const float* at;
  const double* gap;
  const bool* used;

  // The squared distance of two points, in squares of the gap that both allow.
  double weight(int64_t u, int64_t v) const {
    const double x = double{at[3 * u]} - at[3 * v], y = double{at[3 * u + 1]} - at[3 * v + 1];
    const double z = double{at[3 * u + 2]} - at[3 * v + 2], least = std::min(gap[u], gap[v]);
    return ((x * x + y * y) + z * z) / (least * least);
  }
};

// Appends the edges of at most `joining` gaps of a block of rows: those of at most one gap to `near`.
template <typename Index>
void find_edges(const Points& points, const Index* neighbors, int64_t count, double joining, int64_t block,
                int64_t num_points, std::vector<Edge>& near, std::vector<Edge>& far) {
  const int64_t last = std::min((block + 1) * kRowsPerBlock, num_points);
  for (int64_t u = block * kRowsPerBlock; u < last; ++u) {
    if (!points.used[u]) continue;
    for (const Index* v = neighbors + u * count; v < neighbors + (u + 1) * count; ++v) {
      if (!points.used[*v]) continue;
      const double weight = points.weight(u, *v);
      if (!(weight <= joining * joining)) continue;  // also skips NaN
      const Edge edge{weight, static_cast<int32_t>(std::min<int64_t>(u, *v)),
                      static_cast<int32_t>(std::max<int64_t>(u, *v))};
      (weight <= 1 ? near : far).push_back(edge);
    }
  }
}

void join(UnionFind& components, const Edge& edge, int64_t min_size) {
  const int32_t a = components.find(edge.u), b = components.find(edge.v);
  if (a != b && std::min(components.size(a), components.size(b)) < min_size) components.join(a, b);
}

template <typename Index>
void connect(const Points& points, const Index* neighbors, int64_t count, int64_t min_size, double joining,
             UnionFind& components) {
  const auto num_points = static_cast<int64_t>(components.num_nodes());
  std::vector<std::vector<Edge>> near(num_blocks(num_points)), far(near.size());
  torch::stable::parallel_for(0, static_cast<int64_t>(near.size()), 1, [&](int64_t begin, int64_t end) {
    for (int64_t block = begin; block < end; ++block) {
      find_edges(points, neighbors, count, joining, block, num_points, near[block], far[block]);
    }
  });
  for (const auto& edges : near) {
    for (const Edge& edge : edges) join(components, edge, kMaxCount);
  }
  std::vector<Edge> left;
  for (const auto& edges : far) {
    for (const Edge& edge : edges) {
      const int32_t a = components.find(edge.u), b = components.find(edge.v);
      if (a != b && std::min(components.size(a), components.size(b)) < min_size) left.push_back(edge);
    }
  }
  std::sort(left.begin(), left.end());
  for (const Edge& edge : left) join(components, edge, min_size);
}

Tensor gap_components(const Tensor& points, const Tensor& gap, const Tensor& neighbors, const Tensor& used,
                      int64_t min_size, double joining) {
  const Tensor places = checked_array(points, ScalarType::Float, {-1, 3}, "points");
  const int64_t count = places.size(0);
  const Tensor gaps = checked_array(gap, ScalarType::Double, {count}, "gap");
  const Tensor table = checked_neighbors(neighbors);
  check(table.size(0) == count, "neighbors: expected ", count, " rows, got ", table.size(0));
  const Tensor may = checked_array(used, ScalarType::Bool, {count}, "used");
  check(min_size >= 0, "min_size: expected a number >= 0, got ", min_size);
  check(joining >= 1, "joining: expected a number >= 1, got ", joining);
  UnionFind components(count);
  with_indices(table, [&](const auto* indices) {
    for (int64_t i = 0; i < count * table.size(1); ++i) check_index(indices[i], count, "neighbors", i);
    const Points given{places.const_data_ptr<float>(), gaps.const_data_ptr<double>(), may.const_data_ptr<bool>()};
    connect(given, indices, table.size(1), min_size, joining, components);
  });
  Tensor labels = torch::stable::new_empty(places, {count}, ScalarType::Long);
  components.write_labels(labels.mutable_data_ptr<int64_t>());
  return labels;
}

}  // namespace

STABLE_TORCH_LIBRARY_FRAGMENT(torchjoint, m) {
  m.def(
      "gap_components(Tensor points, Tensor gap, Tensor neighbors, Tensor used, int min_size, float joining)"
      " -> Tensor");
}

STABLE_TORCH_LIBRARY_IMPL(torchjoint, CPU, m) { m.impl("gap_components", TORCH_BOX(&gap_components)); }

}  // namespace torchjoint
