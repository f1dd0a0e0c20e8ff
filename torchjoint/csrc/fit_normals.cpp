// Normals of planes fitted to neighbourhoods: the direction in which each neighbourhood varies least.
#include "neighbors.h"

#include <cmath>
#include <numbers>

namespace torchjoint {
namespace {

struct Vector {
  double x, y, z;
};

Vector operator*(double s, const Vector& v) { return {s * v.x, s * v.y, s * v.z}; }
Vector operator+(const Vector& a, const Vector& b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
double dot(const Vector& a, const Vector& b) { return (a.x * b.x + a.y * b.y) + a.z * b.z; }
Vector cross(const Vector& a, const Vector& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
Vector normalized(const Vector& v) { return (1 / std::sqrt(dot(v, v))) * v; }

struct Symmetric {
  double xx, yy, zz, xy, xz, yz;

  double largest_entry() const {
    return std::max({std::abs(xx), std::abs(yy), std::abs(zz), std::abs(xy), std::abs(xz), std::abs(yz)});
  }
  Symmetric scaled(double s) const { return {s * xx, s * yy, s * zz, s * xy, s * xz, s * yz}; }
  Symmetric shifted(double s) const { return {xx + s, yy + s, zz + s, xy, xz, yz}; }
  double trace() const { return xx + yy + zz; }
  double squared_norm() const { return (xx * xx + yy * yy + zz * zz) + 2 * (xy * xy + xz * xz + yz * yz); }
  double determinant() const {
    return xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz);
  }
  Vector times(const Vector& v) const {
    return {xx * v.x + xy * v.y + xz * v.z, xy * v.x + yy * v.y + yz * v.z, xz * v.x + yz * v.y + zz * v.z};
  }
};

constexpr Vector kUp = {0, 0, 1};

// Of an eigenvalue that is well apart from the others: the matrix less the eigenvalue has rank 2, and its rows span
// the plane across the eigenvector. Their longest product is the most exact.
Vector eigenvector(const Symmetric& matrix, double eigenvalue) {
  const Symmetric m = matrix.shifted(-eigenvalue);
  const Vector rows[] = {{m.xx, m.xy, m.xz}, {m.xy, m.yy, m.yz}, {m.xz, m.yz, m.zz}};
  const Vector products[] = {cross(rows[0], rows[1]), cross(rows[0], rows[2]), cross(rows[1], rows[2])};
  const Vector* longest = std::max_element(
      products, products + 3, [](const Vector& a, const Vector& b) { return dot(a, a) < dot(b, b); });
  return normalized(*longest);
}

// Any unit vector across a unit vector.
Vector across(const Vector& v) {
  return normalized(std::abs(v.x) > std::abs(v.y) ? Vector{-v.z, 0, v.x} : Vector{0, v.z, -v.y});
}

// In the plane across the eigenvector of the largest eigenvalue, the direction of the smaller of the other two.
Vector smallest_across(const Symmetric& matrix, const Vector& largest) {
  const Vector u = across(largest), v = cross(largest, u);
  const Vector mu = matrix.times(u), mv = matrix.times(v);
  const double uv = dot(u, mv), half_difference = (dot(u, mu) - dot(v, mv)) / 2;
  const double length = std::sqrt(half_difference * half_difference + uv * uv);
  if (!(length > 0)) return u;  // the points are on a line: any direction across it is as good
  // The two forms are the same direction; each is exact where the other would cancel.
  return normalized(half_difference >= 0 ? -uv * u + (half_difference + length) * v
                                         : (half_difference - length) * u + uv * v);
}

// Eigenvalues in closed form (O. Smith, "Eigenvalues of a symmetric 3x3 matrix", Comm. ACM 1961). Of the largest and
// the smallest the one that is farther from the middle one is used first, so that nearly equal eigenvalues do no harm.
Vector smallest_eigenvector(const Symmetric& covariance) {
  const double scale = covariance.largest_entry();
  if (!(scale > 0)) return kUp;  // the points coincide
  const Symmetric unit = covariance.scaled(1 / scale);
  const Symmetric deviator = unit.shifted(-unit.trace() / 3);
  const double p = std::sqrt(deviator.squared_norm() / 6);
  if (!(p > 0)) return kUp;  // no direction differs from another
  const Symmetric b = deviator.scaled(1 / p);  // eigenvalues 2 cos(angle + k 2 pi / 3)
  const double half_determinant = std::clamp(b.determinant() / 2, -1.0, 1.0);
  const double angle = std::acos(half_determinant) / 3;
  if (half_determinant < 0) return eigenvector(b, 2 * std::cos(angle + 2 * std::numbers::pi / 3));
  return smallest_across(b, eigenvector(b, 2 * std::cos(angle)));
}

// A plane has two normals: take the upper one (z > 0, or else y > 0, or else x > 0).
Vector upper(const Vector& v) {
  const double sign = v.z != 0 ? v.z : v.y != 0 ? v.y : v.x;
  return sign < 0 ? Vector{-v.x, -v.y, -v.z} : v;
}

// Relative to the point itself, in double: exact far from the origin, too.
template <typename Value, typename Index>
bool covariance(const Value* points, int64_t num_points, int64_t i, const Index* row, int64_t length, Symmetric& out) {
  const Value* p = points + 3 * i;
  Vector sum{};
  Symmetric square{};
  for (int64_t k = 0; k < length; ++k) {
    const int64_t j = row[k];
    if (static_cast<uint64_t>(j) >= static_cast<uint64_t>(num_points)) return false;
    const double x = static_cast<double>(points[3 * j]) - p[0], y = static_cast<double>(points[3 * j + 1]) - p[1],
                 z = static_cast<double>(points[3 * j + 2]) - p[2];
    sum = sum + Vector{x, y, z};
    square.xx += x * x, square.yy += y * y, square.zz += z * z;
    square.xy += x * y, square.xz += x * z, square.yz += y * z;
  }
  const double n = static_cast<double>(length + 1);
  const Vector mean = (1 / n) * sum;
  out = {square.xx - sum.x * mean.x, square.yy - sum.y * mean.y, square.zz - sum.z * mean.z,
         square.xy - sum.x * mean.y, square.xz - sum.x * mean.z, square.yz - sum.y * mean.z};
  return true;
}

template <typename Value, typename Index>
void fit(const Value* points, const Index* neighbors, int64_t num_points, int64_t row_length, float* normals) {
  for_blocks_of_rows(neighbors, num_points, row_length, [&](int64_t, int64_t first, int64_t last) {
    for (int64_t i = first; i < last; ++i) {
      Symmetric c;
      if (!covariance(points, num_points, i, neighbors + i * row_length, row_length, c)) return false;
      const Vector n = row_length < 2 ? kUp : upper(smallest_eigenvector(c));
      normals[3 * i] = static_cast<float>(n.x);
      normals[3 * i + 1] = static_cast<float>(n.y);
      normals[3 * i + 2] = static_cast<float>(n.z);
    }
    return true;
  });
}

Tensor fit_normals(const Tensor& points, const Tensor& neighbors) {
  check(points.is_cpu(), "points: expected a CPU tensor");
  check(is_floating(points), "points: expected dtype torch.float32 or torch.float64");
  check(points.dim() == 2 && points.size(1) == 3, "points: expected shape [N, 3]");
  const Tensor table = checked_neighbors(neighbors);
  check(table.size(0) == points.size(0), "neighbors: expected shape [", points.size(0), ", K]");
  const Tensor coordinates = torch::stable::contiguous(points);
  Tensor normals = torch::stable::new_empty(coordinates, {points.size(0), 3}, ScalarType::Float);
  with_values(coordinates, [&](const auto* values) {
    with_indices(table, [&](const auto* indices) {
      fit(values, indices, table.size(0), table.size(1), normals.mutable_data_ptr<float>());
    });
  });
  return normals;
}

}  // namespace

STABLE_TORCH_LIBRARY_FRAGMENT(torchjoint, m) {
  m.def("fit_normals(Tensor points, Tensor neighbors) -> Tensor");
}

STABLE_TORCH_LIBRARY_IMPL(torchjoint, CPU, m) {
  m.impl("fit_normals", TORCH_BOX(&fit_normals));
}

}  // namespace torchjoint
