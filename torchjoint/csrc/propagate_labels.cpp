// Geodesic label propagation: every pixel takes the label of the marker with the cheapest path to the pixel.
#include "common.h"

#include <array>
#include <cmath>

namespace torchjoint {
namespace {

// Costs are whole numbers, this many per pixel width, so that equal costs compare as equal.
constexpr float kUnits = 8;
constexpr double kMaxWeight = 1000;
constexpr int32_t kFar = std::numeric_limits<int32_t>::max();

struct Step {
  int64_t down, right;
  float length;
  int32_t least;  // cost
};

constexpr float kDiagonal = 1.41421356f;
constexpr std::array<Step, 8> kSteps{{{0, 1, 1, 8},
                                      {1, 0, 1, 8},
                                      {0, -1, 1, 8},
                                      {-1, 0, 1, 8},
                                      {1, 1, kDiagonal, 11},
                                      {-1, 1, kDiagonal, 11},
                                      {1, -1, kDiagonal, 11},
                                      {-1, -1, kDiagonal, 11}}};

struct Pixel {
  float red, green, blue, boundary;
};

// Dijkstra's algorithm with one bucket per cost (Dial 1969): the cost of a step is at least
// 1 and less than the number of buckets.
class LabelPropagation {
 public:
  LabelPropagation(std::vector<Pixel> pixels, int64_t height, int64_t width, float color_weight, float boundary_weight)
      : pixels_(std::move(pixels)), height_(height), width_(width), color_weight_(color_weight),
        boundary_weight_(boundary_weight), cost_(pixels_.size(), kFar),
        buckets_(static_cast<size_t>(kUnits * (kDiagonal + 1.7320509f * color_weight + boundary_weight)) + 3) {}

  // Markers are the labels >= 0.
  void run(int32_t* labels) {
    for (size_t pixel = 0; pixel < cost_.size(); ++pixel) {
      if (labels[pixel] >= 0) reach(static_cast<int32_t>(pixel), 0);
    }
    for (int32_t cost = 0; waiting_ > 0; ++cost) {
      std::vector<int32_t>& bucket = buckets_[cost % buckets_.size()];
      waiting_ -= bucket.size();
      for (const int32_t pixel : bucket) {
        if (cost_[pixel] == cost) leave(pixel, cost, labels);
      }
      bucket.clear();
    }
  }

 private:
  void reach(int32_t pixel, int32_t cost) {
    cost_[pixel] = cost;
    buckets_[cost % buckets_.size()].push_back(pixel);
    ++waiting_;
  }

  void leave(int32_t pixel, int32_t cost, int32_t* labels) {
    const int64_t row = pixel / width_, column = pixel % width_;
    for (const Step& step : kSteps) {
      if (row + step.down < 0 || row + step.down >= height_) continue;
      if (column + step.right < 0 || column + step.right >= width_) continue;
      const int32_t next = static_cast<int32_t>(pixel + step.down * width_ + step.right);
      if (cost_[next] < cost + step.least) continue;
      const int32_t there = cost + cost_of(pixels_[pixel], pixels_[next], step.length);
      if (there < cost_[next]) {
        reach(next, there);
        labels[next] = labels[pixel];
      } else if (there == cost_[next]) {
        labels[next] = std::min(labels[next], labels[pixel]);
      }
    }
  }

  int32_t cost_of(const Pixel& a, const Pixel& b, float length) const {
    const float red = a.red - b.red, green = a.green - b.green, blue = a.blue - b.blue;
    const float distance = std::sqrt(red * red + green * green + blue * blue);
    const float boundary = std::min(a.boundary, b.boundary);
    return static_cast<int32_t>(
        std::nearbyint(kUnits * (length + color_weight_ * distance + boundary_weight_ * boundary)));
  }

  std::vector<Pixel> pixels_;
  int64_t height_, width_;
  float color_weight_, boundary_weight_;
  std::vector<int32_t> cost_;
  std::vector<std::vector<int32_t>> buckets_;
  size_t waiting_ = 0;
};

float checked_share(float value, const char* name, int64_t position) {
  if (!(value >= 0 && value <= 1)) [[unlikely]] {
    fail(name, ": expected numbers in [0, 1], got ", value, " at ", position);
  }
  return value;
}

Tensor propagate_labels(const Tensor& markers, const Tensor& colors, const Tensor& boundary, double color_weight,
                     double boundary_weight) {
  const Tensor marker = checked_array(markers, ScalarType::Int, {-1, -1}, "markers");
  const int64_t height = marker.size(0), width = marker.size(1), num_pixels = height * width;
  check_image_size(height, width);
  const Tensor color = checked_array(colors, ScalarType::Float, {3, height, width}, "colors");
  const Tensor boundaries = checked_array(boundary, ScalarType::Float, {height, width}, "boundary");
  check(color_weight >= 0 && color_weight <= kMaxWeight, "color_weight: expected 0 to 1000, got ", color_weight);
  check(boundary_weight >= 0 && boundary_weight <= kMaxWeight, "boundary_weight: expected 0 to 1000, got ",
        boundary_weight);
  // The cheapest path costs at most as much as a straight path. A straight path has fewer steps than this limit, and
  // each step costs less than 2^15, so the sum fits 32 bits.
  check(std::max(height, width) < (1 << 16), "markers: expected sides of fewer than 2^16 pixels, got ", height, " x ",
        width);

  const float* const plane = color.const_data_ptr<float>();
  const float* const strength = boundaries.const_data_ptr<float>();
  std::vector<Pixel> pixels(num_pixels);
  for (int64_t i = 0; i < num_pixels; ++i) {
    pixels[i] = {checked_share(plane[i], "colors", i), checked_share(plane[i + num_pixels], "colors", i + num_pixels),
                 checked_share(plane[i + 2 * num_pixels], "colors", i + 2 * num_pixels),
                 checked_share(strength[i], "boundary", i)};
  }
  Tensor labels = torch::stable::new_empty(marker, {height, width}, ScalarType::Int);
  int32_t* const out = labels.mutable_data_ptr<int32_t>();
  std::copy_n(marker.const_data_ptr<int32_t>(), num_pixels, out);
  LabelPropagation(std::move(pixels), height, width, static_cast<float>(color_weight), static_cast<float>(boundary_weight))
      .run(out);
  return labels;
}

}  // namespace

STABLE_TORCH_LIBRARY_FRAGMENT(torchjoint, m) {
  m.def(
      "propagate_labels(Tensor markers, Tensor colors, Tensor boundary, float color_weight, float boundary_weight)"
      " -> Tensor");
}

STABLE_TORCH_LIBRARY_IMPL(torchjoint, CPU, m) {
  m.impl("propagate_labels", TORCH_BOX(&propagate_labels));
}

}  // namespace torchjoint
