// The operator felzenszwalb_image: segments images. The edges of the 8-connected grid (eq. 1) and their weights (eq. 2)
// are computed again, row by row, at each read; they are never stored.
#include <atomic>
#include <cmath>
#include <limits>
#include <optional>

#include "common.h"
#include "components.h"

namespace torchjoint {
namespace {

// An edge from (r + first_row, c) to (r + second_row, c + step).
struct Direction {
  int first_row, second_row, step;
};

constexpr std::array<Direction, 4> kDirections{{{0, 0, 1}, {0, 1, 0}, {0, 1, 1}, {1, 0, 1}}};  // right, down, diagonals

struct Image {
  const float* colors;  // [channels, height, width]
  const float* boundary;  // [height, width], or null
  int64_t channels, height, width;
  float color_weight, boundary_weight;
};

class Grid {
 public:
  explicit Grid(const Image& image) : image_(image) {
    for (size_t d = 0; d < kDirections.size(); ++d) {
      const Direction direction = kDirections[d];
      offset_[d] = static_cast<int32_t>((direction.second_row - direction.first_row) * image.width + direction.step);
    }
  }

  using Edge = uint32_t;  // 4 * first pixel + direction

  Ends ends(Edge edge) const {
    const int32_t pixel = edge / kDirections.size();
    return {pixel, pixel + offset_[edge % kDirections.size()]};
  }

  template <typename Function>
  void read(Function f) const {
    std::array<uint32_t, kBlock> keys;
    for (size_t d = 0; d < kDirections.size(); ++d) {
      const Direction direction = kDirections[d];
      const int64_t rows = image_.height - std::max(direction.first_row, direction.second_row);
      const int64_t columns = image_.width - direction.step;
      for (int64_t row = 0; row < rows; ++row) {
        for (int64_t column = 0; column < columns; column += kBlock) {
          const size_t count = std::min<int64_t>(kBlock, columns - column);
          const int64_t pixel = (row + direction.first_row) * image_.width + column;
          write_keys(pixel, pixel + offset_[d], count, keys.data());
          f(keys.data(), count, [=](size_t i) { return static_cast<Edge>((pixel + i) * kDirections.size() + d); });
        }
      }
    }
  }

 private:
  // w = w_c |c_u - c_v| + w_b min(b_u, b_v), with the same rounding as torchjoint.images.pixel_graph.pixel_weights.
  void write_keys(int64_t u, int64_t v, size_t count, uint32_t* keys) const {
    std::array<float, kBlock> sum;
    std::fill_n(sum.data(), count, 0.0f);
    for (int64_t channel = 0; channel < image_.channels; ++channel) {
      const float* plane = image_.colors + channel * image_.height * image_.width;
      for (size_t i = 0; i < count; ++i) {
        const float difference = plane[u + i] - plane[v + i];
        sum[i] += difference * difference;
      }
    }
    if (image_.boundary == nullptr) {
      for (size_t i = 0; i < count; ++i) keys[i] = sort_key(image_.color_weight * std::sqrt(sum[i]));
      return;
    }
    for (size_t i = 0; i < count; ++i) {
      const float boundary = std::min(image_.boundary[u + i], image_.boundary[v + i]);
      keys[i] = sort_key(image_.color_weight * std::sqrt(sum[i]) + image_.boundary_weight * boundary);
    }
  }

  Image image_;
  std::array<int32_t, 4> offset_;  // from the first pixel of an edge to the second
};

void segment_image(const Image& image, float scale, int64_t min_size, int64_t* labels) {
  const int64_t num_pixels = image.height * image.width;
  Components components(num_pixels, scale, min_size);
  segment(Grid(image), components, 2 * num_pixels, num_pixels);
  components.write_labels(labels);
}

Tensor checked_image(const Tensor& image, int64_t dimensions, const char* name, const char* shape) {
  check(image.is_cpu(), name, ": expected a CPU tensor");
  check(image.scalar_type() == ScalarType::Float, name, ": expected dtype torch.float32");
  check(image.dim() == dimensions, name, ": expected shape ", shape);
  return torch::stable::contiguous(image);
}

// Weights must be neither NaN nor infinite; if |values| are below 1e18, the sum of their squares is finite.
void check_values(const float* values, int64_t count, const char* name) {
  constexpr float kLimit = 1e18f;
  for (int64_t i = 0; i < count; ++i) {
    if (!(std::abs(values[i]) < kLimit)) [[unlikely]] {
      fail(name, ": expected numbers between -1e18 and 1e18, got ", values[i]);
    }
  }
}

Tensor felzenszwalb_image(const Tensor& images, const std::optional<Tensor>& boundaries, double scale, int64_t min_size,
                          double color_weight, double boundary_weight) {
  const Tensor colors = checked_image(images, 4, "images", "[B, C, H, W]");
  const int64_t batch = colors.size(0), channels = colors.size(1), height = colors.size(2), width = colors.size(3);
  const int64_t num_pixels = height * width;
  check(num_pixels <= kMaxCount / 2, "images: expected fewer than 2^30 pixels, got ", num_pixels);
  check(scale >= 0, "scale: expected a number >= 0, got ", scale);
  check(min_size >= 0, "min_size: expected a number >= 0, got ", min_size);
  check(color_weight >= 0 && color_weight < 1e18, "color_weight: expected a number >= 0, got ", color_weight);
  check(boundary_weight >= 0 && boundary_weight < 1e18, "boundary_weight: expected a number >= 0, got ",
        boundary_weight);
  const float* color_data = colors.const_data_ptr<float>();
  check_values(color_data, batch * channels * num_pixels, "images");

  const float* boundary_data = nullptr;
  std::optional<Tensor> boundary;
  if (boundaries.has_value()) {
    boundary = checked_image(*boundaries, 3, "boundaries", "[B, H, W]");
    check(boundary->size(0) == batch && boundary->size(1) == height && boundary->size(2) == width,
          "boundaries: expected shape [", batch, ", ", height, ", ", width, "], as the images have");
    boundary_data = boundary->const_data_ptr<float>();
    check_values(boundary_data, batch * num_pixels, "boundaries");
  }

  Tensor labels = torch::stable::new_empty(colors, {batch, height, width}, ScalarType::Long);
  int64_t* label_data = labels.mutable_data_ptr<int64_t>();
  std::atomic<bool> out_of_memory = false;  // an exception must not leave the parallel loop
  torch::stable::parallel_for(0, batch, 1, [&](int64_t begin, int64_t end) {
    try {
      for (int64_t b = begin; b < end; ++b) {
        const Image image{color_data + b * channels * num_pixels,
                          boundary_data == nullptr ? nullptr : boundary_data + b * num_pixels,
                          channels,
                          height,
                          width,
                          static_cast<float>(color_weight),
                          static_cast<float>(boundary_weight)};
        segment_image(image, static_cast<float>(scale), min_size, label_data + b * num_pixels);
      }
    } catch (const std::bad_alloc&) {
      out_of_memory = true;
    }
  });
  if (out_of_memory) throw std::bad_alloc();
  return labels;
}

}  // namespace

STABLE_TORCH_LIBRARY_FRAGMENT(torchjoint, m) {
  m.def(
      "felzenszwalb_image(Tensor images, Tensor? boundaries, float scale, SymInt min_size=0, float color_weight=1.0,"
      " float boundary_weight=1.0) -> Tensor");
}

STABLE_TORCH_LIBRARY_IMPL(torchjoint, CPU, m) { m.impl("felzenszwalb_image", TORCH_BOX(&felzenszwalb_image)); }

}  // namespace torchjoint
