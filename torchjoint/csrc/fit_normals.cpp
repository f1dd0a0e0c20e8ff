// Normals of planes fitted to neighbourhoods: the direction in which each neighbourhood varies least.
#include "neighbors.h"
#include "plane.h"

namespace torchjoint {
namespace {

template <typename Value, typename Index>
void fit(const Value* points, const Index* neighbors, const RowOrder& order, int64_t num_points, int64_t row_length,
         float* normals) {
  for_blocks_of_rows(neighbors, num_points, row_length, [&](int64_t, int64_t first, int64_t last) {
    for (int64_t place = first; place < last; ++place) {
      const int64_t i = order.row(place);
      Scatter sums;
      for (int64_t k = 0; k < row_length; ++k) {
        const int64_t j = neighbors[i * row_length + k];
        if (static_cast<uint64_t>(j) >= static_cast<uint64_t>(num_points)) return false;
        sums.add(from_to(points, i, j));
      }
      const Vector n = row_length < 2 ? kUp : upper(smallest_eigenvector(sums.covariance()));
      normals[3 * i] = static_cast<float>(n.x);
      normals[3 * i + 1] = static_cast<float>(n.y);
      normals[3 * i + 2] = static_cast<float>(n.z);
    }
    return true;
  });
}

Tensor fit_normals(const Tensor& points, const Tensor& neighbors, const std::optional<Tensor>& order) {
  check(points.is_cpu(), "points: expected a CPU tensor");
  check(is_floating(points), "points: expected dtype torch.float32 or torch.float64");
  check(points.dim() == 2 && points.size(1) == 3, "points: expected shape [N, 3]");
  const Tensor table = checked_neighbors(neighbors);
  check(table.size(0) == points.size(0), "neighbors: expected shape [", points.size(0), ", K]");
  const RowOrder rows(order, points.size(0));
  const Tensor coordinates = torch::stable::contiguous(points);
  Tensor normals = torch::stable::new_empty(coordinates, {points.size(0), 3}, ScalarType::Float);
  with_values(coordinates, [&](const auto* values) {
    with_indices(table, [&](const auto* indices) {
      fit(values, indices, rows, table.size(0), table.size(1), normals.mutable_data_ptr<float>());
    });
  });
  return normals;
}

}  // namespace

TORCHJOINT_OPERATOR(fit_normals, "(Tensor points, Tensor neighbors, Tensor? order=None) -> Tensor");

}  // namespace torchjoint
