// One-to-one matching of the set pixels of two maps, as many pairs as there can be.
#include "common.h"

#include <algorithm>
#include <cmath>
#include <tuple>
#include <utility>

namespace torchjoint {
namespace {

// The places of an image's pixels in a wider one, so that no offset within the radius leads out of it.
struct Frame {
  Frame(int64_t height, int64_t width, double radius)
      : height(height), width(width),
        rows(static_cast<int64_t>(std::min<double>(radius, std::max<int64_t>(height - 1, 0)))),
        columns(static_cast<int64_t>(std::min<double>(radius, std::max<int64_t>(width - 1, 0)))),
        stride(width + 2 * columns) {
    check_image_size(height + 2 * rows, stride);
  }

  int64_t size() const { return (height + 2 * rows) * stride; }

  template <typename Function>
  void for_each_pixel(Function&& function) const {
    for (int64_t row = 0; row < height; ++row) {
      for (int64_t column = 0; column < width; ++column) {
        function(row * width + column, static_cast<int32_t>((row + rows) * stride + column + columns));
      }
    }
  }

  // All offsets no longer than the radius, as differences of places: by length, then by row, then by column.
  std::vector<int32_t> offsets_within(double radius) const {
    std::vector<std::pair<int64_t, int32_t>> found;
    for (int64_t row = -rows; row <= rows; ++row) {
      for (int64_t column = -columns; column <= columns; ++column) {
        const int64_t square = row * row + column * column;
        if (static_cast<double>(square) <= radius * radius) {
          found.emplace_back(square, static_cast<int32_t>(row * stride + column));
        }
      }
    }
    std::sort(found.begin(), found.end());
    std::vector<int32_t> offsets;
    for (const auto& [square, offset] : found) offsets.push_back(offset);
    return offsets;
  }

  int64_t height, width;
  int64_t rows, columns;  // of the margin
  int64_t stride;
};

// Pixels are named by their place. One that is set in the one map may be matched to one that is in the other.
class Matching {
 public:
  Matching(const bool* pred, const bool* target, const Frame& frame, double radius)
      : offsets_(frame.offsets_within(radius)), pred_of_(frame.size(), kNoPixel), target_of_(frame.size(), kFree),
        is_closed_(frame.size(), false), reached_from_(frame.size()) {
    frame.for_each_pixel([&](int64_t pixel, int32_t place) {
      if (pred[pixel]) waiting_.push_back(place);
      if (target[pixel]) pred_of_[place] = kFree;
    });
    match_nearest();
    for (const int32_t pixel : waiting_) augment(pixel);
  }

  bool is_pred_matched(int32_t place) const { return target_of_[place] >= 0; }
  bool is_target_matched(int32_t place) const { return pred_of_[place] >= 0; }

 private:
  void match(int32_t pixel, int32_t target) {
    target_of_[pixel] = target;
    pred_of_[target] = pixel;
  }

  // Two pairs at one offset have no pixel in common, so their order does not matter.
  void match_nearest() {
    for (const int32_t offset : offsets_) {
      size_t left = 0;
      for (const int32_t pixel : waiting_) {
        if (pred_of_[pixel + offset] == kFree) {
          match(pixel, pixel + offset);
        } else {
          waiting_[left++] = pixel;
        }
      }
      waiting_.resize(left);
    }
  }

  // Matches one more pixel along a shortest alternating path to a free target, if there is one (Berge 1957).
  void augment(int32_t start) {
    queue_.assign(1, start);
    visited_.clear();
    for (size_t next = 0; next < queue_.size(); ++next) {
      for (const int32_t offset : offsets_) {
        const int32_t target = queue_[next] + offset;
        if (pred_of_[target] == kNoPixel || is_closed_[target]) continue;
        is_closed_[target] = true;
        visited_.push_back(target);
        reached_from_[target] = queue_[next];
        if (pred_of_[target] == kFree) {
          flip(target);
          for (const int32_t other : visited_) is_closed_[other] = false;
          return;
        }
        queue_.push_back(pred_of_[target]);
      }
    }
    // From the targets visited no free one can be reached, now or later: they stay closed to all further searches.
  }

  void flip(int32_t target) {
    while (target != kFree) {
      const int32_t pixel = reached_from_[target], previous = target_of_[pixel];
      match(pixel, target);
      target = previous;
    }
  }

  // Instead of a partner.
  static constexpr int32_t kFree = -1, kNoPixel = -2;

  std::vector<int32_t> offsets_;
  std::vector<int32_t> waiting_;  // predicted pixels without a partner, ascending
  std::vector<int32_t> pred_of_;  // the partner of each pixel of the target
  std::vector<int32_t> target_of_;  // the partner of each predicted pixel
  std::vector<uint8_t> is_closed_;  // to the search
  std::vector<int32_t> reached_from_, queue_, visited_;
};

std::tuple<Tensor, Tensor> match_pixels(const Tensor& pred, const Tensor& target, double radius) {
  const Tensor preds = checked_array(pred, ScalarType::Bool, {-1, -1}, "pred");
  const int64_t height = preds.size(0), width = preds.size(1);
  const Tensor targets = checked_array(target, ScalarType::Bool, {height, width}, "target");
  check(std::isfinite(radius) && radius >= 0, "radius: expected a finite number >= 0, got ", radius);

  const Frame frame(height, width, radius);
  const Matching matching(preds.const_data_ptr<bool>(), targets.const_data_ptr<bool>(), frame, radius);
  Tensor pred_matched = torch::stable::new_empty(preds, {height, width}, ScalarType::Bool);
  Tensor target_matched = torch::stable::new_empty(preds, {height, width}, ScalarType::Bool);
  bool* const pred_out = pred_matched.mutable_data_ptr<bool>();
  bool* const target_out = target_matched.mutable_data_ptr<bool>();
  frame.for_each_pixel([&](int64_t pixel, int32_t place) {
    pred_out[pixel] = matching.is_pred_matched(place);
    target_out[pixel] = matching.is_target_matched(place);
  });
  return {pred_matched, target_matched};
}

}  // namespace

STABLE_TORCH_LIBRARY_FRAGMENT(torchjoint, m) {
  m.def("match_pixels(Tensor pred, Tensor target, float radius) -> (Tensor, Tensor)");
}

STABLE_TORCH_LIBRARY_IMPL(torchjoint, CPU, m) {
  m.impl("match_pixels", TORCH_BOX(&match_pixels));
}

}  // namespace torchjoint
