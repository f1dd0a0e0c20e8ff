// Adds a depth image to the sums of a truncated signed distance volume (Curless and Levoy 1996). The sums are of whole
// numbers, and one thread handles a block, so they depend neither on the threads nor on the order of the images.
#include "common.h"

#include <algorithm>
#include <cmath>

namespace torchjoint {
namespace {

constexpr int64_t kSide = 8, kVoxels = kSide * kSide * kSide, kBlocksAtOnce = 16;
// A cell has the sums of distances, of weights and of three colours.
constexpr int64_t kChannels = 5;
// A distance of one truncation is kUnit. With at most kMaxWeight images the sums fit 32 bits.
constexpr int32_t kUnit = 1 << 14;
constexpr int32_t kMaxWeight = 1 << 16;

// The nearest whole number. std::floor would be a call without newer processors' instructions.
inline int32_t rounded(double value) {
  const double up = value + 0.5;
  const auto whole = static_cast<int32_t>(up);
  return whole - (whole > up);
}

// Adds as two's complement does: sums that no image made may overflow.
inline void increase(int32_t& sum, int32_t value) {
  sum = static_cast<int32_t>(static_cast<uint32_t>(sum) + static_cast<uint32_t>(value));
}

struct View {
  double rows[12], fx, fy, cx, cy, voxel_size, truncation, far;
  const float* depth;
  const uint8_t* color;
  int64_t height, width;

  // Adds a row of voxels along the third axis. Where they are in the image is computed for all of them at once.
  void add_row(double x, double y, const double* z, int32_t* cell) const {
    double away[kSide], column[kSide], row[kSide], squared[kSide];
    const double across = rows[0] * x + rows[1] * y, below = rows[4] * x + rows[5] * y,
                 ahead = rows[8] * x + rows[9] * y;
    for (int64_t i = 0; i < kSide; ++i) {
      away[i] = (ahead + rows[10] * z[i]) + rows[11];
      const double right = ((across + rows[2] * z[i]) + rows[3]) / away[i];
      const double down = ((below + rows[6] * z[i]) + rows[7]) / away[i];
      column[i] = fx * right + cx + 0.5;
      row[i] = fy * down + cy + 0.5;
      squared[i] = 1 + (right * right + down * down);
    }
    for (int64_t i = 0; i < kSide; ++i, cell += kChannels)
      if (away[i] > 0) add(away[i], column[i], row[i], squared[i], cell);  // not if it is NaN
  }

  void add(double away, double column, double row, double squared, int32_t* cell) const {
    if (!(column >= 0 && column < static_cast<double>(width) && row >= 0 && row < static_cast<double>(height))) return;
    const int64_t pixel = static_cast<int64_t>(row) * width + static_cast<int64_t>(column);
    const double measured = depth[pixel];
    if (!(measured > 0 && measured <= far && measured - away > -truncation) || cell[1] >= kMaxWeight) return;
    int32_t units = kUnit;  // far in front of the surface: along the ray, the distance is only larger
    if (measured - away < truncation) {
      const double distance = (measured - away) * std::sqrt(squared);  // along the ray
      if (!(distance > -truncation)) return;
      units = rounded(std::min(1.0, distance / truncation) * kUnit);
    }
    increase(cell[0], units);
    increase(cell[1], 1);
    for (int64_t channel = 0; channel < 3; ++channel) increase(cell[2 + channel], color[3 * pixel + channel]);
  }

  void add_block(const int64_t* block, int32_t* cell) const {
    double place[3][kSide];
    for (int axis = 0; axis < 3; ++axis)
      for (int64_t i = 0; i < kSide; ++i)
        place[axis][i] = (static_cast<double>(block[axis] * kSide + i) + 0.5) * voxel_size;
    for (int64_t i = 0; i < kSide; ++i)
      for (int64_t j = 0; j < kSide; ++j, cell += kSide * kChannels) add_row(place[0][i], place[1][j], place[2], cell);
  }
};

void integrate_depth(const Tensor& sums, const Tensor& row, const Tensor& block, const Tensor& depth,
                     const Tensor& color, const Tensor& intrinsics, const Tensor& world_to_camera, double voxel_size,
                     double truncation, double far) {
  checked_array(sums, ScalarType::Int, {-1, kVoxels, kChannels}, "sums");
  check(sums.is_contiguous(), "sums: expected a contiguous tensor, because it is changed in place");
  const Tensor rows = checked_array(row, ScalarType::Long, {-1}, "row");
  const Tensor blocks = checked_array(block, ScalarType::Long, {rows.size(0), 3}, "block");
  const Tensor image = checked_array(depth, ScalarType::Float, {-1, -1}, "depth");
  const Tensor colors = checked_array(color, ScalarType::Byte, {image.size(0), image.size(1), 3}, "color");
  const Tensor matrix = checked_array(intrinsics, ScalarType::Double, {3, 3}, "intrinsics");
  const Tensor pose = checked_array(world_to_camera, ScalarType::Double, {4, 4}, "world_to_camera");
  check(voxel_size > 0, "voxel_size: expected a number > 0, got ", voxel_size);
  check(truncation > 0, "truncation: expected a number > 0, got ", truncation);
  const int64_t* to = rows.const_data_ptr<int64_t>();
  const int64_t* at = blocks.const_data_ptr<int64_t>();
  for (int64_t b = 0; b < rows.size(0); ++b) {
    check_index(to[b], sums.size(0), "row", b);
    check(b == 0 || to[b] > to[b - 1], "row: expected ascending numbers, got ", to[b], " at ", b);
    for (int axis = 0; axis < 3; ++axis)
      check(at[3 * b + axis] >= -kMaxCount && at[3 * b + axis] <= kMaxCount, "block: expected numbers of 32 bits, got ",
            at[3 * b + axis]);
  }

  const double* k = matrix.const_data_ptr<double>();
  const float* const depths = image.const_data_ptr<float>();
  const uint8_t* const pixels = colors.const_data_ptr<uint8_t>();
  View view{{}, k[0], k[4], k[2], k[5], voxel_size, truncation, far, depths, pixels, image.size(0), image.size(1)};
  std::copy_n(pose.const_data_ptr<double>(), 12, view.rows);
  int32_t* const cells = sums.mutable_data_ptr<int32_t>();
  parallel_for_each(rows.size(0), kBlocksAtOnce,
                    [&](int64_t b) { view.add_block(at + 3 * b, cells + to[b] * kVoxels * kChannels); });
}

}  // namespace

TORCHJOINT_OPERATOR(integrate_depth,
                    "(Tensor(a!) sums, Tensor row, Tensor block, Tensor depth, Tensor color, Tensor intrinsics, Tensor "
                    "world_to_camera, float voxel_size, float truncation, float far) -> ()");

}  // namespace torchjoint
