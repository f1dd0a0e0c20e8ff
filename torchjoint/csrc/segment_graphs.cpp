// A separate 8-connected pixel graph for each chosen segment of an image.
#include "common.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <tuple>
#include <vector>

namespace torchjoint {
namespace {

// An image's colours and boundaries, and the weight of the edge between two of its pixels (eq. 2).
struct Image {
  float weight(int64_t i, int64_t j) const {
    const float red = colors[i] - colors[j], green = colors[size + i] - colors[size + j],
                blue = colors[2 * size + i] - colors[2 * size + j];
    const float distance = std::sqrt((red * red + green * green) + blue * blue);
    return color_weight * distance + boundary_weight * std::min(boundary[i], boundary[j]);
  }

  const float* colors;  // [3, size]
  const float* boundary;
  int64_t size;
  float color_weight, boundary_weight;
};

struct Step {
  int32_t down, right;  // from an edge's first end to its second
};
constexpr std::array<Step, 4> kSteps = {{{0, 1}, {1, 0}, {1, 1}, {-1, 1}}};

// The pixels of the chosen segments, segment by segment, in ascending order within a segment.
struct Nodes {
  Nodes(const int32_t* labels, int64_t height, int64_t width, const bool* chosen, int64_t num_labels)
      : number_at(height * width) {
    std::vector<int64_t> next(num_labels);  // first the sizes of the segments, then the next free place of each
    for (int64_t i = 0; i < height * width; ++i) {
      if (labels[i] == -1) continue;
      check_index(labels[i], num_labels, "labels", i);
      ++next[labels[i]];
    }
    for (int64_t label = 0; label < num_labels; ++label) {
      if (!chosen[label]) continue;
      start.push_back(start.back() + next[label]);
      next[label] = start[start.size() - 2];
    }
    pixel.resize(start.back());
    std::vector<int64_t> first = next;
    for (int64_t i = 0; i < height * width; ++i) {
      const int32_t label = labels[i];
      if (label == -1 || !chosen[label]) continue;
      number_at[i] = static_cast<int32_t>(next[label] - first[label]);
      pixel[next[label]++] = i;
    }
  }

  std::vector<int64_t> start{0};  // of each chosen segment, in `pixel`
  std::vector<int64_t> pixel;  // row x width + column
  std::vector<int32_t> number_at;  // number of a pixel within its segment; read only in chosen segments
};

struct Graphs {
  std::vector<int64_t> start{0};  // of each segment's edges
  std::vector<int32_t> first, second;  // the edges' two ends, as pixel numbers within the segment
  std::vector<double> weight;
};

// Appends a segment's edges, sorted by direction, then by their first ends.
void connect(const int32_t* labels, int64_t height, int64_t width, const int64_t* pixel, int64_t count,
             const std::vector<int32_t>& number_at, const Image& image, Graphs& graphs) {
  for (const Step step : kSteps) {
    const int64_t ahead = step.down * width + step.right;
    for (int64_t i = 0; i < count; ++i) {
      const int64_t here = pixel[i];
      const int64_t row = static_cast<int32_t>(here) / static_cast<int32_t>(width);
      if (row + step.down < 0 || row + step.down >= height) continue;
      if (here - row * width + step.right >= width || labels[here + ahead] != labels[here]) continue;
      graphs.first.push_back(static_cast<int32_t>(i));
      graphs.second.push_back(number_at[here + ahead]);
      graphs.weight.push_back(image.weight(here, here + ahead));
    }
  }
}

// Divides the weights by their mean: w / sigma of eq. 14. If all weights are 0, they stay 0.
void divide_by_mean(double* weight, int64_t count) {
  double sum = 0;
  for (int64_t e = 0; e < count; ++e) sum += weight[e];
  if (!(sum > 0)) return;
  const double mean = sum / static_cast<double>(count);
  for (int64_t e = 0; e < count; ++e) weight[e] /= mean;
}

std::tuple<Tensor, Tensor, Tensor, Tensor, Tensor> segment_graphs(const Tensor& labels, const Tensor& chosen,
                                                                  const Tensor& colors, const Tensor& boundary,
                                                                  double color_weight, double boundary_weight) {
  const Tensor segments = checked_array(labels, ScalarType::Int, {-1, -1}, "labels");
  const int64_t height = segments.size(0), width = segments.size(1), size = height * width;
  check_image_size(height, width);
  check(color_weight >= 0, "color_weight: expected a number >= 0, got ", color_weight);
  check(boundary_weight >= 0, "boundary_weight: expected a number >= 0, got ", boundary_weight);
  const Tensor choice = checked_array(chosen, ScalarType::Bool, {-1}, "chosen");
  const Tensor color = checked_array(colors, ScalarType::Float, {3, height, width}, "colors");
  const Tensor boundaries = checked_array(boundary, ScalarType::Float, {height, width}, "boundary");

  const int32_t* label = segments.const_data_ptr<int32_t>();
  const Nodes nodes(label, height, width, choice.const_data_ptr<bool>(), choice.size(0));
  const Image image{color.const_data_ptr<float>(), boundaries.const_data_ptr<float>(), size,
                    static_cast<float>(color_weight), static_cast<float>(boundary_weight)};
  Graphs graphs;
  for (auto* ends : {&graphs.first, &graphs.second}) ends->reserve(4 * nodes.pixel.size());
  graphs.weight.reserve(4 * nodes.pixel.size());
  for (size_t s = 0; s + 1 < nodes.start.size(); ++s) {
    connect(label, height, width, nodes.pixel.data() + nodes.start[s], nodes.start[s + 1] - nodes.start[s],
            nodes.number_at, image, graphs);
    const int64_t start = graphs.start.back(), end = static_cast<int64_t>(graphs.weight.size());
    divide_by_mean(graphs.weight.data() + start, end - start);
    graphs.start.push_back(end);
  }

  return {to_tensor(nodes.pixel, ScalarType::Long, segments), to_tensor(nodes.start, ScalarType::Long, segments),
          to_pairs(graphs.first, graphs.second, segments), to_tensor(graphs.start, ScalarType::Long, segments),
          to_tensor(graphs.weight, ScalarType::Double, segments)};
}

}  // namespace

TORCHJOINT_OPERATOR(segment_graphs,
                    "(Tensor labels, Tensor chosen, Tensor colors, Tensor boundary, float color_weight, float "
                    "boundary_weight) -> (Tensor pixel, Tensor node_ptr, Tensor edge_index, Tensor edge_ptr, Tensor "
                    "relative_weight)");

}  // namespace torchjoint
