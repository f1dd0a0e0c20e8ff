// Planes on one side of a boundary: each is fitted to a point and its neighbours in the same region.
#include "neighbors.h"
#include "plane.h"

namespace torchjoint {
namespace {

template <typename Index>
void fit(const float* points, const Index* neighbors, const int64_t* region, const float* normals, int64_t num_points,
         int64_t row_length, int64_t min_points, float* means, float* fitted) {
  for_blocks_of_rows(neighbors, num_points, row_length, [&](int64_t, int64_t first, int64_t last) {
    for (int64_t i = first; i < last; ++i) {
      Scatter sums;
      for (int64_t k = 0; k < row_length; ++k) {
        const int64_t j = neighbors[i * row_length + k];
        if (static_cast<uint64_t>(j) >= static_cast<uint64_t>(num_points)) return false;
        if (region[j] == region[i]) sums.add(from_to(points, i, j));
      }
      const float *p = points + 3 * i, *given = normals + 3 * i;
      const Vector m = sums.mean(), old = {given[0], given[1], given[2]};
      Vector n = old;
      if (sums.count() + 1 >= min_points) {
        n = smallest_eigenvector(sums.covariance());
        if (dot(n, old) < 0) n = -1.0 * n;
      }
      const double mean[] = {p[0] + m.x, p[1] + m.y, p[2] + m.z}, normal[] = {n.x, n.y, n.z};
      for (int axis = 0; axis < 3; ++axis) {
        means[3 * i + axis] = static_cast<float>(mean[axis]);
        fitted[3 * i + axis] = static_cast<float>(normal[axis]);
      }
    }
    return true;
  });
}

std::tuple<Tensor, Tensor> region_planes(const Tensor& points, const Tensor& neighbors, const Tensor& region,
                                         const Tensor& normals, int64_t min_points) {
  const Tensor coordinates = checked_array(points, ScalarType::Float, {-1, 3}, "points");
  const int64_t num_points = coordinates.size(0);
  const Tensor table = checked_neighbors(neighbors);
  check(table.size(0) == num_points, "neighbors: expected shape [", num_points, ", K]");
  const Tensor regions = checked_array(region, ScalarType::Long, {num_points}, "region");
  const Tensor old = checked_array(normals, ScalarType::Float, {num_points, 3}, "normals");
  check(min_points >= 3, "min_points: expected at least 3, got ", min_points);
  Tensor means = torch::stable::new_empty(coordinates, {num_points, 3}, ScalarType::Float);
  Tensor fitted = torch::stable::new_empty(coordinates, {num_points, 3}, ScalarType::Float);
  with_indices(table, [&](const auto* indices) {
    fit(coordinates.const_data_ptr<float>(), indices, regions.const_data_ptr<int64_t>(), old.const_data_ptr<float>(),
        num_points, table.size(1), min_points, means.mutable_data_ptr<float>(), fitted.mutable_data_ptr<float>());
  });
  return {means, fitted};
}

}  // namespace

TORCHJOINT_OPERATOR(region_planes,
                    "(Tensor points, Tensor neighbors, Tensor region, Tensor normals, int min_points) -> (Tensor, "
                    "Tensor)");

}  // namespace torchjoint
