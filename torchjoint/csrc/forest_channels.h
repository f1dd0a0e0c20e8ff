// Computes the channels of an image that a structured forest tests: colours, gradients and their orientations.
//
// They equal those of OpenCV's detector up to float32 rounding (P. Dollar, C. L. Zitnick, "Fast Edge Detection
// Using Structured Forests", PAMI 2015).
#pragma once

#include <torch/csrc/stable/ops.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <cstdint>
#include <vector>

#include "array.h"

namespace torchjoint {

constexpr int64_t kChannels = 13, kOrientations = 4;
// The image is extended by so many mirrored pixels on each side, because patches cross its border.
constexpr int64_t kPadding = 8;
// Rows in one task of a thread.
constexpr int64_t kTaskRows = 32;

// The row or column that is the mirror image of a place outside [0, length). The pixel at the border is repeated, unless
// `inner` is true.
inline int64_t mirrored(int64_t place, int64_t length, bool inner = false) {
  if (place >= 0 && place < length) return place;
  if (length == 1) return 0;
  const int64_t period = inner ? 2 * length - 2 : 2 * length;
  place = ((place % period) + period) % period;
  return place < length ? place : (inner ? period : period - 1) - place;
}

// Calls function(begin, end) for parts of the tasks 0, ..., count - 1, on all threads of the calling thread.
template <typename Function>
void in_parallel(int64_t count, Function&& function) {
  std::atomic<bool> out_of_memory = false;  // an exception must not leave the parallel loop
  torch::stable::parallel_for(0, count, 1, [&](int64_t begin, int64_t end) {
    try {
      function(begin, end);
    } catch (const std::bad_alloc&) {
      out_of_memory = true;
    }
  });
  if (out_of_memory) throw std::bad_alloc();
}

// Calls function(first, last) for blocks of rows, in parallel.
template <typename Function>
void in_blocks(int64_t rows, Function&& function) {
  in_parallel((rows + kTaskRows - 1) / kTaskRows, [&](int64_t begin, int64_t end) {
    for (int64_t block = begin; block < end; ++block) {
      function(block * kTaskRows, std::min((block + 1) * kTaskRows, rows));
    }
  });
}

// Rows [first, last) of an image, filtered with weights that fall linearly with distance up to `radius`. The image is
// mirrored at its border, without its outermost pixels.
template <int radius>
void triangle_filter(const float* in, float* out, int64_t height, int64_t width, int64_t first, int64_t last) {
  std::array<float, radius + 1> weight;  // by distance
  constexpr double kSum = (radius + 1) * (radius + 1);
  for (int i = 0; i <= radius; ++i) weight[i] = static_cast<float>((radius + 1 - i) / kSum);
  std::vector<float> row(width + 2 * radius), across((last - first + 2 * radius) * width);
  for (int64_t y = first - radius; y < last + radius; ++y) {
    const float* const from = in + mirrored(y, height, true) * width;
    std::copy_n(from, width, row.begin() + radius);
    for (int i = 1; i <= radius; ++i) {
      row[radius - i] = from[mirrored(-i, width, true)];
      row[radius + width - 1 + i] = from[mirrored(width - 1 + i, width, true)];
    }
    const float* const middle = row.data() + radius;
    float* const to = across.data() + (y - first + radius) * width;
    for (int64_t x = 0; x < width; ++x) {
      float sum = weight[0] * middle[x];
      for (int i = 1; i <= radius; ++i) sum += weight[i] * (middle[x - i] + middle[x + i]);
      to[x] = sum;
    }
  }
  for (int64_t y = first; y < last; ++y) {
    const float* const middle = across.data() + (y - first + radius) * width;
    float* const to = out + y * width;
    for (int64_t x = 0; x < width; ++x) {
      float sum = weight[0] * middle[x];
      for (int i = 1; i <= radius; ++i) sum += weight[i] * (middle[x - i * width] + middle[x + i * width]);
      to[x] = sum;
    }
  }
}

// Lightness of CIE Luv by 1024 steps of Y, divided by 270.
inline const std::array<float, 1024>& lightness_table() {
  static const std::array<float, 1024> table = [] {
    std::array<float, 1024> values;
    constexpr double kSlope = 29.0 * 29 * 29 / 27;
    for (int i = 0; i < 1024; ++i) {
      const double y = i / 1024.0;
      values[i] = static_cast<float>((y > 8 / kSlope ? 116 * std::cbrt(y) - 16 : y * kSlope) / 270);
    }
    return values;
  }();
  return table;
}

// Converts `count` RGB pixels to CIE Luv, each value about in [0, 1].
inline void rgb_to_luv(const float* red, const float* green, const float* blue, int64_t count, float* lightness,
                       float* u, float* v) {
  constexpr float kU = static_cast<float>(13 * 0.197833), kV = static_cast<float>(13 * 0.468331);
  const std::array<float, 1024>& table = lightness_table();
  for (int64_t i = 0; i < count; ++i) {
    const float y = (0.222015f * red[i] + 0.706655f * green[i]) + 0.071330f * blue[i];
    lightness[i] = table[static_cast<int32_t>(std::clamp(1024 * y, 0.0f, 1023.0f))];
  }
  for (int64_t i = 0; i < count; ++i) {
    const float x = (0.430574f * red[i] + 0.341550f * green[i]) + 0.178325f * blue[i];
    const float y = (0.222015f * red[i] + 0.706655f * green[i]) + 0.071330f * blue[i];
    const float z = (0.020183f * red[i] + 0.129553f * green[i]) + 0.939180f * blue[i];
    const float n = 1 / (((x + 15 * y) + 3 * z) + 1e-35f);
    u[i] = lightness[i] * ((52 * x) * n - kU) + static_cast<float>(88.0 / 270);
    v[i] = lightness[i] * ((117 * y) * n - kV) + static_cast<float>(134.0 / 270);
  }
}

// Magnitude and orientation of the gradient in one row of three planes; each pixel uses the plane with the largest
// gradient. `rows` are the row above, the row itself and the row below, of each plane. Orientations are 0 to 3: across,
// falling, down, rising.
inline void gradient_row(const std::array<std::array<const float*, 3>, 3>& rows, int64_t width, float* magnitude,
                         int32_t* orientation) {
  // At this ratio OpenCV's polynomial for the arc tangent gives 22.5 degrees, the limit between two orientations.
  constexpr float kParting = 0.41412405f;
  const auto pixel = [&](int64_t left, int64_t x, int64_t right) {
    float best = -1, across = 0, down = 0;
    for (int plane = 0; plane < 3; ++plane) {
      const float dx = rows[plane][1][right] - rows[plane][1][left], dy = rows[plane][2][x] - rows[plane][0][x];
      const float squared = dx * dx + dy * dy;
      across = squared > best ? dx : across;
      down = squared > best ? dy : down;
      best = squared > best ? squared : best;
    }
    magnitude[x] = std::sqrt(best);
    const float ax = std::abs(across), ay = std::abs(down);
    const int32_t diagonal = across * down > 0 ? 1 : 3;
    const int32_t found = ay < kParting * ax ? 0 : (ax < kParting * ay ? 2 : diagonal);
    orientation[x] = ax < 1e-5f && ay < 1e-5f ? 2 : found;
  };
  pixel(0, 0, std::min<int64_t>(1, width - 1));
  for (int64_t x = 1; x < width - 1; ++x) pixel(x - 1, x, x + 1);
  if (width > 1) pixel(width - 2, width - 1, width - 1);
}

// The channels of images of one size, at half resolution. Memory is reused for the next image.
class ForestChannels {
 public:
  ForestChannels(int64_t height, int64_t width)
      : rows(height / 2 + kPadding + height % 2), columns(width / 2 + kPadding + width % 2), height_(height),
        width_(width), padded_height_(2 * rows), padded_width_(2 * columns),
        memory_(plane() * (4 * 6 + kChannels + 2 * kChannels)),
        values_(memory_.data() + plane() * (4 * 6 + kChannels)) {}

  int64_t plane() const { return rows * columns; }

  // [26, rows, columns]: the channels weakly smoothed, for features that are single values; then strongly smoothed, for
  // features that are differences.
  const float* values() const { return values_; }

  // Computes values() of an image [3, height, width] of finite numbers; an odd side is extended by one mirrored pixel.
  void compute(const float* image) {
    float *const luv = memory_.data(), *const raw = luv + 4 * 6 * plane();
    pad_and_convert(image, luv);
    in_blocks(3 * rows, [&](int64_t first, int64_t last) {
      for (int64_t row = first; row < last; ++row) halve_row(luv + 2 * row * padded_width_, raw + row * columns);
    });
    gradients<2>(luv, padded_height_, padded_width_, raw + 3 * plane());
    gradients<1>(raw, rows, columns, raw + (4 + kOrientations) * plane());
    const int64_t blocks = (rows + kTaskRows - 1) / kTaskRows;
    in_parallel(kChannels * blocks, [&](int64_t begin, int64_t end) {
      for (int64_t task = begin; task < end; ++task) {
        const int64_t channel = task / blocks, first = task % blocks * kTaskRows;
        const float* const from = raw + channel * plane();
        const int64_t last = std::min(first + kTaskRows, rows);
        triangle_filter<1>(from, values_ + channel * plane(), rows, columns, first, last);
        triangle_filter<4>(from, values_ + (kChannels + channel) * plane(), rows, columns, first, last);
      }
    });
  }

  const int64_t rows, columns;

 private:
  void pad_and_convert(const float* image, float* luv) const {
    const int64_t source = height_ * width_, target = padded_height_ * padded_width_;
    in_blocks(height_, [&](int64_t first, int64_t last) {
      for (int64_t row = first; row < last; ++row) {
        const float* const from = image + row * width_;
        float* const to = luv + (row + kPadding) * padded_width_ + kPadding;
        rgb_to_luv(from, from + source, from + 2 * source, width_, to, to + target, to + 2 * target);
        for (float* line : {to, to + target, to + 2 * target}) {
          for (int64_t x = -kPadding; x < 0; ++x) line[x] = line[mirrored(x, width_)];
          for (int64_t x = width_; x < padded_width_ - kPadding; ++x) line[x] = line[mirrored(x, width_)];
        }
      }
    });
    for (int64_t row = -kPadding; row < padded_height_ - kPadding; ++row) {
      const int64_t same = mirrored(row, height_);
      if (same == row) continue;
      for (float* part : {luv, luv + target, luv + 2 * target}) {
        std::copy_n(part + (same + kPadding) * padded_width_, padded_width_, part + (row + kPadding) * padded_width_);
      }
    }
  }

  void halve_row(const float* above, float* out) const {
    const float* const below = above + padded_width_;
    for (int64_t x = 0; x < columns; ++x) {
      out[x] = ((above[2 * x] + above[2 * x + 1]) + (below[2 * x] + below[2 * x + 1])) * 0.25f;
    }
  }

  // Writes the normalised gradient magnitude, and its sums over cells of `cell` pixels by orientation: 5 channels.
  template <int cell>
  void gradients(const float* luv, int64_t height, int64_t width, float* channels) {
    const int64_t size = height * width;
    float* const magnitude = memory_.data() + 3 * 4 * plane();
    float* const around = magnitude + size;
    int32_t* const orientation = reinterpret_cast<int32_t*>(around + size);
    in_blocks(height, [&](int64_t first, int64_t last) {
      for (int64_t row = first; row < last; ++row) {
        const int64_t above = std::max<int64_t>(row - 1, 0), below = std::min(row + 1, height - 1);
        std::array<std::array<const float*, 3>, 3> rows;
        for (int i = 0; i < 3; ++i) {
          const float* const part = luv + i * size;
          rows[i] = {part + above * width, part + row * width, part + below * width};
        }
        gradient_row(rows, width, magnitude + row * width, orientation + row * width);
      }
    });
    in_blocks(height, [&](int64_t first, int64_t last) {
      triangle_filter<4>(magnitude, around, height, width, first, last);
      for (int64_t i = first * width; i < last * width; ++i) around[i] = magnitude[i] / (around[i] + 0.01f);
    });
    in_blocks(rows, [&](int64_t first, int64_t last) {
      for (int64_t row = first; row < last; ++row) {
        float* const out = channels + row * columns;
        const int64_t from = row * cell * width;
        if (cell == 1) {
          std::copy_n(around + from, columns, out);
        } else {
          halve_row(around + from, out);
        }
        for (int32_t turn = 0; turn < kOrientations; ++turn) {
          sum_cells<cell>(around + from, orientation + from, width, turn, out + (1 + turn) * plane());
        }
      }
    });
  }

  template <int cell>
  void sum_cells(const float* value, const int32_t* orientation, int64_t width, int32_t turn, float* out) const {
    for (int64_t x = 0; x < columns; ++x) {
      float sum = 0;
      for (int64_t down = 0; down < cell; ++down) {
        for (int64_t right = 0; right < cell; ++right) {
          const int64_t place = down * width + cell * x + right;
          const float share = value[place] * (1.0f / (cell * cell));  // always read, to avoid a branch
          sum += orientation[place] == turn ? share : 0.0f;
        }
      }
      out[x] = sum;
    }
  }

  const int64_t height_, width_, padded_height_, padded_width_;
  Array<float> memory_;  // Luv; magnitude, its local mean, and orientation; then the channels; then values()
  float* const values_;
};

}  // namespace torchjoint
