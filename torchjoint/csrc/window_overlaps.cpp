// Overlap of the label windows at the two ends of an edge (eq. 5), for edges with two visible ends.
#include "common.h"

#include <algorithm>
#include <tuple>
#include <vector>

namespace torchjoint {
namespace {

struct Bin {
  int32_t label;
  int32_t count;
};

// Histograms of the labels around pixels, in ascending order of labels; most histograms have one bin.
class Windows {
 public:
  Windows(const int32_t* labels, int64_t height, int64_t width, int64_t window, int64_t num_points)
      : labels_(labels), height_(height), width_(width), reach_(window / 2) {
    windows_.reserve(num_points);
    bins_.reserve(num_points);
  }

  // Appends the histogram of the window around a pixel. The window is clipped at the image border; pixels without a
  // label (-1) do not count.
  void add(int64_t row, int64_t column) {
    const int64_t top = std::max<int64_t>(row - reach_, 0), bottom = std::min(row + reach_, height_ - 1);
    const int64_t left = std::max<int64_t>(column - reach_, 0), right = std::min(column + reach_, width_ - 1);
    runs_.clear();
    for (int64_t y = top; y <= bottom; ++y) {
      for (int64_t x = left; x <= right; ++x) add_pixel(labels_[y * width_ + x]);
    }
    Window added{bins_.size(), 0, 0};
    for (const Bin& run : runs_) added.size += run.count;
    if (runs_.size() > 1) std::sort(runs_.begin(), runs_.end(), [](Bin a, Bin b) { return a.label < b.label; });
    for (const Bin& run : runs_) {
      if (bins_.size() > added.start && bins_.back().label == run.label) {
        bins_.back().count += run.count;
      } else {
        bins_.push_back(run);
      }
    }
    added.num_bins = static_cast<int32_t>(bins_.size() - added.start);
    windows_.push_back(added);
  }

  // Number of labelled pixels in a window.
  int32_t size(int32_t slot) const { return windows_[slot].size; }

  // Histogram intersection: the sum over labels of the smaller of the two counts.
  int32_t intersection(int32_t first, int32_t second) const {
    const Window &one = windows_[first], &other = windows_[second];
    size_t a = one.start, b = other.start;
    const size_t a_end = a + one.num_bins, b_end = b + other.num_bins;
    int32_t common = 0;
    while (a < a_end && b < b_end) {
      if (bins_[a].label == bins_[b].label) {
        common += std::min(bins_[a++].count, bins_[b++].count);
      } else if (bins_[a].label < bins_[b].label) {
        ++a;
      } else {
        ++b;
      }
    }
    return common;
  }

 private:
  struct Window {
    size_t start;  // in bins_
    int32_t num_bins;
    int32_t size;
  };

  void add_pixel(int32_t label) {
    if (label < 0) return;
    if (!runs_.empty() && runs_.back().label == label) {
      ++runs_.back().count;
    } else {
      runs_.push_back({label, 1});
    }
  }

  const int32_t* labels_;
  int64_t height_, width_, reach_;
  std::vector<Bin> bins_, runs_;
  std::vector<Window> windows_;
};

std::tuple<Tensor, Tensor> window_overlaps(
    const Tensor& order, const Tensor& other_end, const Tensor& start, const Tensor& point, const Tensor& row,
    const Tensor& column, const Tensor& labels, int64_t window) {
  const Tensor orders = checked_array(order, ScalarType::Int, {-1}, "order");
  const int64_t num_edges = orders.size(0);
  const Tensor other_ends = checked_array(other_end, ScalarType::Int, {num_edges}, "other_end");
  const Tensor starts = checked_array(start, ScalarType::Int, {-1}, "start");
  const int64_t num_nodes = starts.size(0) - 1;
  check(num_nodes >= 0, "start: expected shape [N + 1], got [0]");
  const Tensor points = checked_array(point, ScalarType::Long, {-1}, "point");
  const int64_t num_points = points.size(0);
  const Tensor rows = checked_array(row, ScalarType::Long, {num_points}, "row");
  const Tensor columns = checked_array(column, ScalarType::Long, {num_points}, "column");
  const Tensor image = checked_array(labels, ScalarType::Int, {-1, -1}, "labels");
  const int64_t height = image.size(0), width = image.size(1);
  check_image_size(height, width);
  check(window > 0 && window % 2 == 1 && window < 32768, "window: expected an odd number below 32768, got ", window);

  Windows windows(image.const_data_ptr<int32_t>(), height, width, window, num_points);
  std::vector<int32_t> slot(num_nodes, -1);  // of a node, among the points seen
  const int64_t* node = points.const_data_ptr<int64_t>();
  const int64_t* r = rows.const_data_ptr<int64_t>();
  const int64_t* c = columns.const_data_ptr<int64_t>();
  for (int64_t i = 0; i < num_points; ++i) {
    check_index(node[i], num_nodes, "point", i);
    check_index(r[i], height, "row", i);
    check_index(c[i], width, "column", i);
    check(slot[node[i]] < 0, "point: expected every point once, got ", node[i], " again at ", i);
    slot[node[i]] = static_cast<int32_t>(i);
    windows.add(r[i], c[i]);
  }

  const int32_t* first_of = starts.const_data_ptr<int32_t>();
  int64_t at_most = 0;
  for (int64_t i = 0; i < num_points; ++i) {
    const int32_t begin = first_of[node[i]], end = first_of[node[i] + 1];
    check(begin >= 0 && begin <= end && end <= num_edges, "start: expected ascending numbers in [0, E]");
    at_most += end - begin;
  }
  // Reserve room for all edges of the points; most of them are visible. Growing arrays would cost more than the loop.
  Tensor edge = torch::stable::new_empty(orders, {at_most}, ScalarType::Long);
  Tensor overlap = torch::stable::new_empty(orders, {at_most}, ScalarType::Double);
  int64_t* const edges = edge.mutable_data_ptr<int64_t>();
  double* const overlaps = overlap.mutable_data_ptr<double>();
  const int32_t* edge_at = orders.const_data_ptr<int32_t>();
  const int32_t* other_at = other_ends.const_data_ptr<int32_t>();
  int64_t count = 0;
  for (int64_t i = 0; i < num_points; ++i) {
    const int32_t own = static_cast<int32_t>(i), size = windows.size(own);
    if (size == 0) continue;
    for (int32_t place = first_of[node[i]]; place < first_of[node[i] + 1]; ++place) {
      check_index(other_at[place], num_nodes, "other_end", place);
      const int32_t there = slot[other_at[place]];
      if (there < 0 || windows.size(there) == 0) continue;
      edges[count] = edge_at[place];
      overlaps[count++] =
          static_cast<double>(windows.intersection(own, there)) / std::min(size, windows.size(there));
    }
  }
  return {torch::stable::narrow(edge, 0, 0, count), torch::stable::narrow(overlap, 0, 0, count)};
}

}  // namespace

STABLE_TORCH_LIBRARY_FRAGMENT(torchjoint, m) {
  m.def(
      "window_overlaps(Tensor order, Tensor other_end, Tensor start, Tensor point, Tensor row, Tensor column,"
      " Tensor labels, SymInt window) -> (Tensor edge, Tensor overlap)");
}

STABLE_TORCH_LIBRARY_IMPL(torchjoint, CPU, m) {
  m.impl("window_overlaps", TORCH_BOX(&window_overlaps));
}

}  // namespace torchjoint
