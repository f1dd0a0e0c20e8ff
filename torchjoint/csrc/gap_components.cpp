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

bool has_small(UnionFind& components, int32_t a, int32_t b, int64_t min_size) {
  return a != b && std::min(components.size(a), components.size(b)) < min_size;
}

// Most edges are within what is already connected, so their weights are not computed.
template <typename Index>
void connect(const Points& points, const Index* neighbors, int64_t count, int64_t min_size, double joining,
             UnionFind& components) {
  std::vector<Edge> far;
  for (int32_t u = 0; u < static_cast<int32_t>(components.num_nodes()); ++u) {
    if (!points.used[u]) continue;
    int32_t a = components.find(u);
    for (const Index* v = neighbors + int64_t{u} * count; v < neighbors + int64_t{u + 1} * count; ++v) {
      if (!points.used[*v]) continue;
      const int32_t b = components.find(static_cast<int32_t>(*v));
      if (a == b) continue;
      const double weight = points.weight(u, *v);
      if (weight <= 1) {
        a = components.join(a, b);
      } else if (min_size > 1 && weight <= joining * joining) {
        far.push_back({weight, std::min(u, static_cast<int32_t>(*v)), std::max(u, static_cast<int32_t>(*v))});
      }
    }
  }
  std::erase_if(far, [&](const Edge& edge) {
    return !has_small(components, components.find(edge.u), components.find(edge.v), min_size);
  });
  std::sort(far.begin(), far.end());
  for (const Edge& edge : far) {
    const int32_t a = components.find(edge.u), b = components.find(edge.v);
    if (has_small(components, a, b, min_size)) components.join(a, b);
  }
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
  const int64_t num_entries = count * table.size(1);
  UnionFind components(count);
  const Points given{places.const_data_ptr<float>(), gaps.const_data_ptr<double>(), may.const_data_ptr<bool>()};
  with_indices(table, [&](const auto* indices) {
    for (int64_t i = 0; i < count; ++i) {
      check(given.gap[i] >= 0, "gap: expected numbers >= 0, got ", given.gap[i], " at ", i);
    }
    for (int64_t i = 0; i < num_entries; ++i) check_index(indices[i], count, "neighbors", i);
    connect(given, indices, table.size(1), min_size, joining, components);
  });
  Tensor labels = torch::stable::new_empty(places, {count}, ScalarType::Long);
  components.write_labels(labels.mutable_data_ptr<int64_t>());
  return labels;
}

}  // namespace

TORCHJOINT_OPERATOR(gap_components,
                    "(Tensor points, Tensor gap, Tensor neighbors, Tensor used, int min_size, float joining) -> "
                    "Tensor");

}  // namespace torchjoint
