// The ultrametric contour map of a boundary map: closed contours. The strength of a contour is the height at which
// region merging removes it.
#include "common.h"
#include "region_graph.h"

#include <cmath>
#include <utility>

namespace torchjoint {
namespace {

// Strengths are multiplied by this and rounded to whole numbers, so that their sums do not depend on the order.
constexpr double kLevels = 65535;

struct Grid {
  int64_t height, width;

  // Pairs of neighbouring pixels, each once: first all to the right, then down, down-right and up-right, row by row.
  template <typename Function>
  void for_each_pair(Function&& function) const {
    const auto pairs = [&](int64_t down, int64_t right) {
      for (int64_t row = std::max<int64_t>(-down, 0); row < height - std::max<int64_t>(down, 0); ++row) {
        for (int64_t column = 0; column < width - right; ++column) {
          const int64_t pixel = row * width + column;
          function(pixel, pixel + down * width + right);
        }
      }
    };
    pairs(0, 1);
    pairs(1, 0);
    pairs(1, 1);
    pairs(-1, 1);
  }
};

// For each pixel of a row: the lowest value among the pixel and its two neighbours in the row, and its index; of equal
// values, the first.
struct LowestInRow {
  explicit LowestInRow(int64_t width) : value(width), place(width) {}

  void fill(const float* relief, int64_t row) {
    const int64_t width = static_cast<int64_t>(value.size());
    const float* const line = relief + row * width;
    const int32_t first = static_cast<int32_t>(row * width);
    for (int64_t x = 0; x < width; ++x) {
      const float left = line[std::max<int64_t>(x - 1, 0)], right = line[std::min(x + 1, width - 1)], here = line[x];
      const float low = std::min(left, here);
      const int64_t place_of_low = left <= here ? std::max<int64_t>(x - 1, 0) : x;
      value[x] = std::min(low, right);
      place[x] = first + static_cast<int32_t>(low <= right ? place_of_low : x + 1);
    }
  }

  std::vector<float> value;
  std::vector<int32_t> place;
};

// For each pixel: the lowest pixel among itself and its neighbours; of equally low pixels the one with the smallest
// number.
std::vector<int32_t> lowest_neighbors(const float* relief, const Grid& grid) {
  std::vector<int32_t> lowest(grid.height * grid.width);
  LowestInRow above(grid.width), here(grid.width), below(grid.width);
  if (grid.height > 0) here.fill(relief, 0);
  above = here;
  for (int64_t row = 0; row < grid.height; ++row) {
    below.fill(relief, std::min(row + 1, grid.height - 1));
    int32_t* const out = lowest.data() + row * grid.width;
    for (int64_t x = 0; x < grid.width; ++x) {
      const bool is_above = above.value[x] <= here.value[x];
      const float low = is_above ? above.value[x] : here.value[x];
      const int32_t place = is_above ? above.place[x] : here.place[x];
      out[x] = low <= below.value[x] ? place : below.place[x];
    }
    std::swap(above, here);
    std::swap(here, below);
  }
  return lowest;
}

// Watershed: the region of each pixel. A region consists of the pixels from which steepest descent leads to the same
// lowest pixel. Regions have the order of their lowest pixels.
std::vector<int32_t> basins(const float* relief, const Grid& grid) {
  const int64_t num_pixels = grid.height * grid.width;
  for (int64_t pixel = 0; pixel < num_pixels; ++pixel) {
    check(!std::isnan(relief[pixel]), "relief: expected no NaN, got NaN at ", pixel);
  }
  const std::vector<int32_t> next = lowest_neighbors(relief, grid);
  std::vector<int32_t> region(num_pixels, kNone), path;
  int32_t num_regions = 0;
  for (int32_t pixel = 0; pixel < num_pixels; ++pixel) {
    if (next[pixel] == pixel) region[pixel] = num_regions++;
  }
  for (int32_t start = 0; start < num_pixels; ++start) {
    int32_t pixel = start;
    for (; region[pixel] == kNone; pixel = next[pixel]) path.push_back(pixel);
    for (const int32_t passed : path) region[passed] = region[pixel];
    path.clear();
  }
  return region;
}

// For each region boundary the height at which it vanishes: the largest mean strength of all boundaries that have
// vanished so far.
std::vector<double> heights(RegionAdjacencyGraph& graph) {
  std::vector<double> height(graph.num_borders());
  double level = 0;
  graph.merge_weakest([](const RegionBoundary&) { return true; },
                      [&](int32_t number) {
                        level = std::max(level, graph.border(number).mean());
                        graph.for_each_part(number, [&](int32_t part) { height[part] = level; });
                        return true;
                      });
  return height;
}

Tensor ultrametric_contours(const Tensor& boundary, const Tensor& relief) {
  const Tensor boundaries = checked_array(boundary, ScalarType::Float, {-1, -1}, "boundary");
  const Grid grid{boundaries.size(0), boundaries.size(1)};
  check_image_size(grid.height, grid.width);
  const Tensor reliefs = checked_array(relief, ScalarType::Float, {grid.height, grid.width}, "relief");
  const int64_t num_pixels = grid.height * grid.width;
  const float* const strength = boundaries.const_data_ptr<float>();
  std::vector<int32_t> level(num_pixels);
  for (int64_t pixel = 0; pixel < num_pixels; ++pixel) {
    const float value = strength[pixel];
    check(value >= 0 && value <= 1, "boundary: expected numbers in [0, 1], got ", value, " at ", pixel);
    level[pixel] = static_cast<int32_t>(std::nearbyint(value * kLevels));
  }

  const std::vector<int32_t> region = basins(reliefs.const_data_ptr<float>(), grid);
  RegionAdjacencyGraph graph(num_pixels == 0 ? 0 : 1 + *std::max_element(region.begin(), region.end()));
  std::vector<int32_t> border;  // region boundary of each pair of pixels in two different regions
  grid.for_each_pair([&](int64_t a, int64_t b) {
    if (region[a] != region[b]) border.push_back(graph.add(region[a], region[b], std::max(level[a], level[b])));
  });
  const std::vector<double> height = heights(graph);

  Tensor contours = torch::stable::new_empty(boundaries, {grid.height, grid.width}, ScalarType::Float);
  float* const out = contours.mutable_data_ptr<float>();
  std::fill_n(out, num_pixels, 0.0f);
  auto next = border.begin();
  grid.for_each_pair([&](int64_t a, int64_t b) {
    if (region[a] == region[b]) return;
    const float value = static_cast<float>(height[*next++] / kLevels);
    out[a] = std::max(out[a], value);
    out[b] = std::max(out[b], value);
  });
  return contours;
}

}  // namespace

TORCHJOINT_OPERATOR(ultrametric_contours, "(Tensor boundary, Tensor relief) -> Tensor");

}  // namespace torchjoint
