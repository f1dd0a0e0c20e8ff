// Maximum one-to-one matching of the set pixels of two maps.
#include "common.h"

#include <algorithm>
#include <cmath>
#include <tuple>
#include <utility>

namespace torchjoint {
namespace {

// Indices of an image's pixels in an image with a margin, so that no offset within the radius leaves it.
struct Frame {
  Frame(int64_t height, int64_t width, double radius)
      : height(height), width(width),
        rows(static_cast<int64_t>(std::min<double>(radius, std::max<int64_t>(height - 1, 0)))),
        columns(static_cast<int64_t>(std::min<double>(radius, std::max<int64_t>(width - 1, 0)))),
        stride(width + 2 * columns) {
    check_image_size(height + 2 * rows, stride);
  }

  int64_t size() const { return (height + 2 * rows) * stride; }

  // Calls `function(pixel, place)` for each set pixel.
  template <typename Function>
  void for_each_set(const bool* map, Function&& function) const {
    for (int64_t row = 0; row < height; ++row) {
      for (int64_t column = 0; column < width; ++column) {
        const int64_t pixel = row * width + column;
        if (map[pixel]) function(pixel, static_cast<int32_t>((row + rows) * stride + column + columns));
      }
    }
  }

  // All offsets within the radius, as differences of places; sorted by length, then row, then column.
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
  int64_t rows, columns;  // width of the margin
  int64_t stride;
};

constexpr int32_t kNone = -1;

// The set pixels of each map are numbered row by row.
class Matching {
 public:
  Matching(const bool* pred, const bool* target, const Frame& frame, double radius)
      : offsets_(frame.offsets_within(radius)), target_at_(frame.size(), kNone) {
    frame.for_each_set(pred, [&](int64_t, int32_t place) { place_.push_back(place); });
    frame.for_each_set(target, [&](int64_t, int32_t place) { target_at_[place] = num_targets_++; });
    target_of_.assign(place_.size(), kNone);
    pred_of_.assign(num_targets_, kNone);
    is_closed_.assign(num_targets_, false);
    reached_from_.assign(num_targets_, kNone);
    for (size_t pixel = 0; pixel < place_.size(); ++pixel) waiting_.push_back(static_cast<int32_t>(pixel));
    match_nearest();
    for (const int32_t pixel : waiting_) augment(pixel);
  }

  bool is_pred_matched(int32_t pixel) const { return target_of_[pixel] != kNone; }
  bool is_target_matched(int32_t target) const { return pred_of_[target] != kNone; }

 private:
  void match(int32_t pixel, int32_t target) {
    target_of_[pixel] = target;
    pred_of_[target] = pixel;
  }

  // Two pairs with the same offset have no pixel in common, so their order does not matter.
  void match_nearest() {
    for (const int32_t offset : offsets_) {
      size_t left = 0;
      for (const int32_t pixel : waiting_) {
        const int32_t target = target_at_[place_[pixel] + offset];
        if (target != kNone && pred_of_[target] == kNone) {
          match(pixel, target);
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
        const int32_t target = target_at_[place_[queue_[next]] + offset];
        if (target == kNone || is_closed_[target]) continue;
        is_closed_[target] = true;
        visited_.push_back(target);
        reached_from_[target] = queue_[next];
        if (pred_of_[target] == kNone) {
          flip(target);
          for (const int32_t other : visited_) is_closed_[other] = false;
          return;
        }
        queue_.push_back(pred_of_[target]);
      }
    }
    // The visited targets lead to no free target, now or later: they are excluded from all further searches.
  }

  void flip(int32_t target) {
    while (target != kNone) {
      const int32_t pixel = reached_from_[target], previous = target_of_[pixel];
      match(pixel, target);
      target = previous;
    }
  }

  std::vector<int32_t> offsets_;
  std::vector<int32_t> target_at_;  // of each place
  int32_t num_targets_ = 0;
  std::vector<int32_t> place_, target_of_;  // of each predicted pixel
  std::vector<int32_t> waiting_;  // predicted pixels without a partner, ascending
  std::vector<int32_t> pred_of_;  // of each target, like the next two
  std::vector<uint8_t> is_closed_;  // whether searches skip the target
  std::vector<int32_t> reached_from_;
  std::vector<int32_t> queue_, visited_;
};

std::tuple<Tensor, Tensor> match_pixels(const Tensor& pred, const Tensor& target, double radius) {
  const Tensor preds = checked_array(pred, ScalarType::Bool, {-1, -1}, "pred");
  const int64_t height = preds.size(0), width = preds.size(1);
  const Tensor targets = checked_array(target, ScalarType::Bool, {height, width}, "target");
  check(std::isfinite(radius) && radius >= 0, "radius: expected a finite number >= 0, got ", radius);

  const Frame frame(height, width, radius);
  const bool* const pred_map = preds.const_data_ptr<bool>();
  const bool* const target_map = targets.const_data_ptr<bool>();
  const Matching matching(pred_map, target_map, frame, radius);
  Tensor pred_matched = torch::stable::new_empty(preds, {height, width}, ScalarType::Bool);
  Tensor target_matched = torch::stable::new_empty(preds, {height, width}, ScalarType::Bool);
  bool* const pred_out = std::copy_n(pred_map, height * width, pred_matched.mutable_data_ptr<bool>()) - height * width;
  bool* const target_out =
      std::copy_n(target_map, height * width, target_matched.mutable_data_ptr<bool>()) - height * width;
  int32_t number = 0;
  frame.for_each_set(pred_map, [&](int64_t pixel, int32_t) { pred_out[pixel] = matching.is_pred_matched(number++); });
  number = 0;
  frame.for_each_set(target_map,
                     [&](int64_t pixel, int32_t) { target_out[pixel] = matching.is_target_matched(number++); });
  return {pred_matched, target_matched};
}

}  // namespace

STABLE_TORCH_LIBRARY_FRAGMENT(torchjoint, m) {
  m.def("match_pixels(Tensor pred, Tensor target, float radius) -> (Tensor, Tensor)");
}

STABLE_TORCH_LIBRARY_IMPL(torchjoint, CPU, m) { m.impl("match_pixels", TORCH_BOX(&match_pixels)); }

}  // namespace torchjoint
