// Overlap of the label windows at the two ends of an edge (eq. 5), for edges with two visible ends.
#include "common.h"
#include "visible_edges.h"

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

std::tuple<Tensor, Tensor> window_overlaps(const Tensor& order, const Tensor& other_end, const Tensor& start,
                                           const Tensor& point, const Tensor& row, const Tensor& column,
                                           const Tensor& labels, int64_t window) {
  const Tensor image = checked_array(labels, ScalarType::Int, {-1, -1}, "labels");
  const int64_t height = image.size(0), width = image.size(1);
  check(window > 0 && window % 2 == 1 && window < 32768, "window: expected an odd number below 32768, got ", window);
  const VisibleEdges visible(order, other_end, start, point, row, column, height, width);
  Windows windows(image.const_data_ptr<int32_t>(), height, width, window, visible.num_points);
  for (int64_t i = 0; i < visible.num_points; ++i) windows.add(visible.rows[i], visible.columns[i]);

  return visible.values<double>(ScalarType::Double, [&](int32_t one, int32_t other, double& overlap) {
    const int32_t smaller = std::min(windows.size(one), windows.size(other));
    if (smaller > 0) overlap = static_cast<double>(windows.intersection(one, other)) / smaller;
    return smaller > 0;
  });
}

}  // namespace

TORCHJOINT_OPERATOR(window_overlaps,
                    "(Tensor order, Tensor other_end, Tensor start, Tensor point, Tensor row, Tensor column, Tensor "
                    "labels, SymInt window) -> (Tensor edge, Tensor overlap)");

}  // namespace torchjoint
