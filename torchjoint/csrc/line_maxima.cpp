// The largest value of an image on the line between the two ends of an edge, for edges with two visible ends.
#include "common.h"
#include "visible_edges.h"

#include <algorithm>
#include <tuple>

namespace torchjoint {
namespace {

// The line is read at its ends and at these quarters.
constexpr int64_t kQuarters = 4;

// quarters / 4, rounded to the nearest integer, halves to the even one, as torch.round does.
int64_t rounded(int64_t quarters) { return (quarters + 1 + ((quarters >> 2) & 1)) >> 2; }

std::tuple<Tensor, Tensor> line_maxima(const Tensor& order, const Tensor& other_end, const Tensor& start,
                                       const Tensor& point, const Tensor& row, const Tensor& column,
                                       const Tensor& image) {
  const Tensor values = checked_array(image, ScalarType::Byte, {-1, -1}, "image");
  const int64_t height = values.size(0), width = values.size(1);
  const VisibleEdges visible(order, other_end, start, point, row, column, height, width);
  const uint8_t* const pixels = values.const_data_ptr<uint8_t>();
  const int64_t *const r = visible.rows, *const c = visible.columns;
  return visible.values<uint8_t>(ScalarType::Byte, [&](int32_t one, int32_t other, uint8_t& maximum) {
    uint8_t largest = 0;
    for (int64_t there = 0; there <= kQuarters; ++there) {
      const int64_t here = kQuarters - there;
      const int64_t y = rounded(here * r[one] + there * r[other]), x = rounded(here * c[one] + there * c[other]);
      largest = std::max(largest, pixels[y * width + x]);
    }
    maximum = largest;
    return true;
  });
}

}  // namespace

TORCHJOINT_OPERATOR(line_maxima,
                    "(Tensor order, Tensor other_end, Tensor start, Tensor point, Tensor row, Tensor column, Tensor "
                    "image) -> (Tensor edge, Tensor maximum)");

}  // namespace torchjoint
