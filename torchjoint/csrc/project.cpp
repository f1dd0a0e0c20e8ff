// Pinhole projection of a cloud; keeps the points between near and far and inside the image frame.
#include "common.h"

#include <cmath>
#include <tuple>
#include <vector>

namespace torchjoint {
namespace {

// The entries of the pose (4x4 or 3x4) and of the intrinsics that the projection needs, in double precision.
struct Camera {
  Camera(const double* pose, const double* intrinsics)
      : fx(intrinsics[0]), fy(intrinsics[4]), cx(intrinsics[2]), cy(intrinsics[5]) {
    std::copy_n(pose, 12, rows);
  }

  double along(int axis, double x, double y, double z) const {
    const double* row = rows + 4 * axis;
    return ((row[0] * x + row[1] * y) + row[2] * z) + row[3];
  }

  double rows[12];
  double fx, fy, cx, cy;
};

std::tuple<Tensor, Tensor, Tensor, Tensor> project(const Tensor& points, const Tensor& camera_from_world,
                                                   const Tensor& intrinsics, double near, double far, int64_t height,
                                                   int64_t width, double margin) {
  const Tensor all = checked_array(points, ScalarType::Float, {-1, 3}, "points");
  const Tensor pose = checked_array(camera_from_world, ScalarType::Double, {4, 4}, "camera_from_world");
  const Tensor matrix = checked_array(intrinsics, ScalarType::Double, {3, 3}, "intrinsics");
  check(near > 0, "near: expected a number > 0, got ", near);
  check(margin >= 0, "margin: expected a number >= 0, got ", margin);
  check_image_size(height, width);

  const Camera camera(pose.const_data_ptr<double>(), matrix.const_data_ptr<double>());
  const double top = height + margin, right = width + margin;
  const float* position = all.const_data_ptr<float>();
  std::vector<int64_t> point;
  std::vector<float> us, vs, zs;
  for (int64_t i = 0; i < all.size(0); ++i, position += 3) {
    const double x = position[0], y = position[1], w = position[2];
    const double z = camera.along(2, x, y, w);
    if (!(z > near && z < far)) continue;  // also skips NaN
    const float u = static_cast<float>(camera.fx * camera.along(0, x, y, w) / z + camera.cx);
    const float v = static_cast<float>(camera.fy * camera.along(1, x, y, w) / z + camera.cy);
    const float column = std::floor(u + 0.5f), row = std::floor(v + 0.5f);
    if (!(column >= -margin && column < right && row >= -margin && row < top)) continue;
    point.push_back(i);
    us.push_back(u);
    vs.push_back(v);
    zs.push_back(static_cast<float>(z));
  }
  return {to_tensor(point, ScalarType::Long, all), to_tensor(us, ScalarType::Float, all),
          to_tensor(vs, ScalarType::Float, all), to_tensor(zs, ScalarType::Float, all)};
}

}  // namespace

TORCHJOINT_OPERATOR(project,
                    "(Tensor points, Tensor camera_from_world, Tensor intrinsics, float near, float far, SymInt "
                    "height, SymInt width, float margin=0.) -> (Tensor point, Tensor u, Tensor v, Tensor z)");

}  // namespace torchjoint
