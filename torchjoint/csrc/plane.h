// Vectors, symmetric 3x3 matrices, and the normal of a fitted plane: the direction in which points vary least.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numbers>

namespace torchjoint {

struct Vector {
  double x, y, z;
};

inline Vector operator*(double s, const Vector& v) { return {s * v.x, s * v.y, s * v.z}; }
inline Vector operator+(const Vector& a, const Vector& b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline double dot(const Vector& a, const Vector& b) { return (a.x * b.x + a.y * b.y) + a.z * b.z; }
inline Vector cross(const Vector& a, const Vector& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
inline Vector normalized(const Vector& v) { return (1 / std::sqrt(dot(v, v))) * v; }

struct Symmetric {
  double xx, yy, zz, xy, xz, yz;

  double largest_entry() const {
    return std::max({std::abs(xx), std::abs(yy), std::abs(zz), std::abs(xy), std::abs(xz), std::abs(yz)});
  }
  Symmetric scaled(double s) const { return {s * xx, s * yy, s * zz, s * xy, s * xz, s * yz}; }
  Symmetric shifted(double s) const { return {xx + s, yy + s, zz + s, xy, xz, yz}; }
  double trace() const { return xx + yy + zz; }
  double squared_norm() const { return (xx * xx + yy * yy + zz * zz) + 2 * (xy * xy + xz * xz + yz * yz); }
  double determinant() const { return xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz); }
  Vector times(const Vector& v) const {
    return {xx * v.x + xy * v.y + xz * v.z, xy * v.x + yy * v.y + yz * v.z, xz * v.x + yz * v.y + zz * v.z};
  }
};

constexpr Vector kUp = {0, 0, 1};

// The eigenvector of an eigenvalue that is well separated from the others. The matrix minus the eigenvalue has rank 2,
// and its rows span the plane perpendicular to the eigenvector. The longest cross product of rows is the most accurate.
inline Vector eigenvector(const Symmetric& matrix, double eigenvalue) {
  const Symmetric m = matrix.shifted(-eigenvalue);
  const Vector rows[] = {{m.xx, m.xy, m.xz}, {m.xy, m.yy, m.yz}, {m.xz, m.yz, m.zz}};
  const Vector products[] = {cross(rows[0], rows[1]), cross(rows[0], rows[2]), cross(rows[1], rows[2])};
  const Vector* longest =
      std::max_element(products, products + 3, [](const Vector& a, const Vector& b) { return dot(a, a) < dot(b, b); });
  return normalized(*longest);
}

// Any unit vector perpendicular to a unit vector.
inline Vector across(const Vector& v) {
  return normalized(std::abs(v.x) > std::abs(v.y) ? Vector{-v.z, 0, v.x} : Vector{0, v.z, -v.y});
}

// The eigenvector of the smaller remaining eigenvalue, in the plane perpendicular to a known eigenvector.
inline Vector smallest_across(const Symmetric& matrix, const Vector& largest) {
  const Vector u = across(largest), v = cross(largest, u);
  const Vector mu = matrix.times(u), mv = matrix.times(v);
  const double uv = dot(u, mv), half_difference = (dot(u, mu) - dot(v, mv)) / 2;
  const double length = std::sqrt(half_difference * half_difference + uv * uv);
  if (!(length > 0)) return u;  // the points are on a line: take any perpendicular direction
  // The two formulas give the same direction; each is accurate where the other suffers from cancellation.
  return normalized(half_difference >= 0 ? -uv * u + (half_difference + length) * v
                                         : (half_difference - length) * u + uv * v);
}

// Eigenvalues in closed form (O. Smith, "Eigenvalues of a symmetric 3x3 matrix", Comm. ACM 1961). The largest or the
// smallest eigenvalue is used first, whichever is farther from the middle one; so nearly equal eigenvalues do no harm.
inline Vector smallest_eigenvector(const Symmetric& covariance) {
  const double scale = covariance.largest_entry();
  if (!(scale > 0)) return kUp;  // the points coincide
  const Symmetric unit = covariance.scaled(1 / scale);
  const Symmetric deviator = unit.shifted(-unit.trace() / 3);
  const double p = std::sqrt(deviator.squared_norm() / 6);
  if (!(p > 0)) return kUp;  // the points vary equally in all directions
  const Symmetric b = deviator.scaled(1 / p);  // eigenvalues 2 cos(angle + k 2 pi / 3)
  const double half_determinant = std::clamp(b.determinant() / 2, -1.0, 1.0);
  const double angle = std::acos(half_determinant) / 3;
  if (half_determinant < 0) return eigenvector(b, 2 * std::cos(angle + 2 * std::numbers::pi / 3));
  return smallest_across(b, eigenvector(b, 2 * std::cos(angle)));
}

// Of the two normals of a plane, the upper one (z > 0, or z = 0 and y > 0, or z = y = 0 and x > 0).
inline Vector upper(const Vector& v) {
  const double sign = v.z != 0 ? v.z : v.y != 0 ? v.y : v.x;
  return sign < 0 ? Vector{-v.x, -v.y, -v.z} : v;
}

// Sums over points in double precision, relative to one point, so that they are also accurate far from the origin.
class Scatter {
 public:
  void add(const Vector& v) {
    ++count_;
    sum_ = sum_ + v;
    square_.xx += v.x * v.x, square_.yy += v.y * v.y, square_.zz += v.z * v.z;
    square_.xy += v.x * v.y, square_.xz += v.x * v.z, square_.yz += v.y * v.z;
  }

  int64_t count() const { return count_; }

  // Mean of the added points and the reference point, relative to the reference point.
  Vector mean() const { return (1 / static_cast<double>(count_ + 1)) * sum_; }

  // The covariance times the number of points.
  Symmetric covariance() const {
    const Vector m = mean();
    return {square_.xx - sum_.x * m.x, square_.yy - sum_.y * m.y, square_.zz - sum_.z * m.z,
            square_.xy - sum_.x * m.y, square_.xz - sum_.x * m.z, square_.yz - sum_.y * m.z};
  }

 private:
  int64_t count_ = 0;
  Vector sum_{};
  Symmetric square_{};
};

// Point j relative to point i, in points [N, 3].
template <typename Value>
Vector from_to(const Value* points, int64_t i, int64_t j) {
  const Value *p = points + 3 * i, *q = points + 3 * j;
  return {static_cast<double>(q[0]) - p[0], static_cast<double>(q[1]) - p[1], static_cast<double>(q[2]) - p[2]};
}

}  // namespace torchjoint
