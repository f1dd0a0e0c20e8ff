// The 8-connected pixel graphs of some of an image's segments, as one graph with as many parts.
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

struct Pixel {
  int32_t row, column, label;
};

struct Step {
  int32_t down, right;  // from an edge's first end to its second
};
constexpr std::array<Step, 4> kSteps = {{{0, 1}, {1, 0}, {1, 1}, {-1, 1}}};

struct Graph {
  std::vector<int32_t> first, second;  // nodes at the ends of each edge
  std::vector<float> weight;
};

// Nodes are the pixels in their order; edges come by direction, then in the order of their first ends.
Graph connect(const int32_t* labels, int64_t height, int64_t width, const std::vector<Pixel>& nodes,
              const std::vector<int32_t>& node_at, const Image& image) {
  Graph graph;
  for (auto* ends : {&graph.first, &graph.second}) ends->reserve(4 * nodes.size());
  graph.weight.reserve(4 * nodes.size());
  for (const Step step : kSteps) {
    const int64_t ahead = step.down * width + step.right;
    for (size_t i = 0; i < nodes.size(); ++i) {
      const int32_t row = nodes[i].row + step.down, column = nodes[i].column + step.right;
      if (row < 0 || row >= height || column >= width) continue;
      const int64_t here = nodes[i].row * width + nodes[i].column;
      if (labels[here + ahead] != nodes[i].label) continue;
      graph.first.push_back(static_cast<int32_t>(i));
      graph.second.push_back(node_at[here + ahead]);
      graph.weight.push_back(image.weight(here, here + ahead));
    }
  }
  return graph;
}

// Weights over the mean weight of their segment: w / sigma of eq. 14; 0 where all of a segment's weights are 0.
std::vector<double> relative(const Graph& graph, const std::vector<Pixel>& nodes, int64_t num_labels) {
  std::vector<double> sum(num_labels);
  std::vector<int64_t> count(num_labels);
  for (size_t e = 0; e < graph.weight.size(); ++e) {
    const int32_t label = nodes[graph.first[e]].label;
    sum[label] += graph.weight[e];
    ++count[label];
  }
  for (int64_t label = 0; label < num_labels; ++label) {
    sum[label] /= static_cast<double>(std::max<int64_t>(count[label], 1));
  }
  std::vector<double> result(graph.weight.size());
  for (size_t e = 0; e < result.size(); ++e) {
    const double mean = sum[nodes[graph.first[e]].label];
    result[e] = mean > 0 ? graph.weight[e] / mean : 0;
  }
  return result;
}

std::tuple<Tensor, Tensor, Tensor> segment_graphs(
    const Tensor& labels, const Tensor& chosen, const Tensor& colors, const Tensor& boundary, double color_weight,
    double boundary_weight) {
  const Tensor segments = checked_array(labels, ScalarType::Int, {-1, -1}, "labels");
  const int64_t height = segments.size(0), width = segments.size(1), size = height * width;
  check_image_size(height, width);
  check(size <= kMaxCount / 4, "labels: expected at most 2^29 pixels, got ", size);
  check(color_weight >= 0, "color_weight: expected a number >= 0, got ", color_weight);
  check(boundary_weight >= 0, "boundary_weight: expected a number >= 0, got ", boundary_weight);
  const Tensor choice = checked_array(chosen, ScalarType::Bool, {-1}, "chosen");
  const Tensor color = checked_array(colors, ScalarType::Float, {3, height, width}, "colors");
  const Tensor boundaries = checked_array(boundary, ScalarType::Float, {height, width}, "boundary");

  const int32_t* label = segments.const_data_ptr<int32_t>();
  const bool* is_chosen = choice.const_data_ptr<bool>();
  const int64_t num_labels = choice.size(0);
  std::vector<Pixel> nodes;
  std::vector<int64_t> pixel;
  std::vector<int32_t> node_at(size);  // only the entries of the chosen segments' pixels are read
  for (int32_t row = 0; row < height; ++row) {
    for (int32_t column = 0; column < width; ++column) {
      const int64_t i = row * width + column;
      if (label[i] == -1) continue;
      check_index(label[i], num_labels, "labels", i);
      if (!is_chosen[label[i]]) continue;
      node_at[i] = static_cast<int32_t>(nodes.size());
      nodes.push_back({row, column, label[i]});
      pixel.push_back(i);
    }
  }
  const Image image{color.const_data_ptr<float>(), boundaries.const_data_ptr<float>(), size,
                    static_cast<float>(color_weight), static_cast<float>(boundary_weight)};
  const Graph graph = connect(label, height, width, nodes, node_at, image);

  const int64_t num_edges = static_cast<int64_t>(graph.weight.size());
  Tensor edge_index = torch::stable::new_empty(segments, {2, num_edges}, ScalarType::Long);
  int64_t* const ends = edge_index.mutable_data_ptr<int64_t>();
  std::copy(graph.first.begin(), graph.first.end(), ends);
  std::copy(graph.second.begin(), graph.second.end(), ends + num_edges);
  return {to_tensor(pixel, ScalarType::Long, segments), edge_index,
          to_tensor(relative(graph, nodes, num_labels), ScalarType::Double, segments)};
}

}  // namespace

STABLE_TORCH_LIBRARY_FRAGMENT(torchjoint, m) {
  m.def(
      "segment_graphs(Tensor labels, Tensor chosen, Tensor colors, Tensor boundary, float color_weight,"
      " float boundary_weight) -> (Tensor pixel, Tensor edge_index, Tensor relative_weight)");
}

STABLE_TORCH_LIBRARY_IMPL(torchjoint, CPU, m) {
  m.impl("segment_graphs", TORCH_BOX(&segment_graphs));
}

}  // namespace torchjoint
