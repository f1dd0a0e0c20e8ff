// A z-buffer in which every point is rendered as a square.
#include "common.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace torchjoint {
namespace {

Tensor splat_depth(const Tensor& row, const Tensor& column, const Tensor& depth, const Tensor& reach, int64_t height,
                   int64_t width) {
  const int64_t num_points = row.dim() == 1 ? row.size(0) : -1;
  const Tensor rows = checked_array(row, ScalarType::Long, {num_points}, "row");
  const Tensor columns = checked_array(column, ScalarType::Long, {num_points}, "column");
  const Tensor depths = checked_array(depth, ScalarType::Float, {num_points}, "depth");
  const Tensor reaches = checked_array(reach, ScalarType::Long, {num_points}, "reach");
  check_image_size(height, width);

  Tensor nearest = torch::stable::new_empty(depths, {height, width}, ScalarType::Float);
  float* const image = nearest.mutable_data_ptr<float>();
  std::fill_n(image, height * width, std::numeric_limits<float>::infinity());
  const int64_t* r = rows.const_data_ptr<int64_t>();
  const int64_t* c = columns.const_data_ptr<int64_t>();
  const int64_t* half = reaches.const_data_ptr<int64_t>();
  const float* z = depths.const_data_ptr<float>();
  for (int64_t i = 0; i < num_points; ++i) {
    const float here = z[i];
    check_index(r[i], height, "row", i);
    check_index(c[i], width, "column", i);
    check_index(half[i], kMaxCount, "reach", i);
    check(!std::isnan(here), "depth: expected no NaN, got NaN at ", i);
    const int64_t top = std::max<int64_t>(r[i] - half[i], 0), bottom = std::min(r[i] + half[i], height - 1);
    const int64_t left = std::max<int64_t>(c[i] - half[i], 0), right = std::min(c[i] + half[i], width - 1);
    for (int64_t y = top; y <= bottom; ++y) {
      float* const line = image + y * width;
      for (int64_t x = left; x <= right; ++x) line[x] = std::min(line[x], here);
    }
  }
  return nearest;
}

}  // namespace

TORCHJOINT_OPERATOR(splat_depth,
                    "(Tensor row, Tensor column, Tensor depth, Tensor reach, SymInt height, SymInt width) -> Tensor");

}  // namespace torchjoint
