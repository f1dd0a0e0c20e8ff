// Finds the markers of an image whose neighbours, by position and colour, mostly have other labels.
#include "common.h"

#include <cmath>
#include <limits>
#include <unordered_map>

namespace torchjoint {
namespace {

constexpr double kMaxWeight = 1000;

struct Marker {
  int32_t row, column;
  float color[3];  // in pixels
  int32_t label;
};

// ((rows² + columns²) + red²) + green²) + blue², given the first sum.
double with_colors(double sum, const Marker& one, const Marker& other) {
  for (int d = 0; d < 3; ++d) {
    const double gap = double{one.color[d]} - double{other.color[d]};
    sum += gap * gap;
  }
  return sum;
}

// The markers in square cells of the image, cell by cell, row by row.
class Cells {
 public:
  Cells(const std::vector<Marker>& markers, int64_t height, int64_t width, int64_t side)
      : side_(side), num_rows_((height + side - 1) / side), num_columns_((width + side - 1) / side),
        start_(num_rows_ * num_columns_ + 1), markers_(markers.size()) {
    for (const Marker& marker : markers) ++start_[cell(marker) + 1];
    for (size_t i = 1; i < start_.size(); ++i) start_[i] += start_[i - 1];
    std::vector<int32_t> next(start_.begin(), start_.end() - 1);
    for (const Marker& marker : markers) markers_[next[cell(marker)]++] = marker;
  }

  int64_t side() const { return side_; }
  int64_t row_of(const Marker& marker) const { return marker.row / side_; }
  int64_t column_of(const Marker& marker) const { return marker.column / side_; }
  int64_t num_rows() const { return num_rows_; }
  int64_t num_columns() const { return num_columns_; }

  // Calls the function for all markers of the cells first, ..., last of a row; cells outside of the image are skipped.
  template <typename Function>
  void for_each(int64_t row, int64_t first, int64_t last, Function f) const {
    if (row < 0 || row >= num_rows_) return;
    first = std::max<int64_t>(first, 0), last = std::min(last, num_columns_ - 1);
    if (first > last) return;
    const int32_t end = start_[row * num_columns_ + last + 1];
    for (int32_t i = start_[row * num_columns_ + first]; i < end; ++i) f(markers_[i]);
  }

 private:
  int64_t cell(const Marker& marker) const { return row_of(marker) * num_columns_ + column_of(marker); }

  int64_t side_, num_rows_, num_columns_;
  std::vector<int32_t> start_;  // of each cell's markers
  std::vector<Marker> markers_;
};

// The nearest markers of one marker: the voters, and one more to detect ties.
class Voters {
 public:
  explicit Voters(int64_t count) : most_(count + 1) { near_.reserve(most_ + 1); }

  // Whether the voters with the marker's label are fewer than half of the voters, and fewer than half of `others`, the
  // other markers with this label. Markers that tie at the last place vote only if all of them fit.
  bool outvote(const Cells& cells, const Marker& marker, int64_t others) {
    near_.clear();
    const int64_t enough = std::min<int64_t>(most_ - 1, others);
    const int64_t side = cells.side(), row = cells.row_of(marker), column = cells.column_of(marker);
    const auto ask = [&](const Marker& other) { take(marker, other); };
    cells.for_each(row, column, column, ask);
    const int64_t above = marker.row - row * side + 1, below = (row + 1) * side - marker.row;
    const int64_t left = marker.column - column * side + 1, right = (column + 1) * side - marker.column;
    const int64_t nearest_side = std::min({above, below, left, right});
    bool is_done = false;
    for (int64_t ring = 1; !is_done; ++ring) {  // of cells; a side of it that is too far is skipped
      is_done = true;
      const int64_t closer = (ring - 1) * side;
      const double known = nearest_side + closer;  // within this distance, all markers are known
      if (2 * count(marker, std::min(farthest(), known * known)).second >= enough)
        return false;  // whatever others vote
      const auto is_near = [&](int64_t gap, bool is_inside) {
        const bool found = is_inside && static_cast<double>(gap + closer) * (gap + closer) < farthest();
        is_done &= !found;
        return found;
      };
      if (is_near(above, row >= ring)) cells.for_each(row - ring, column - ring, column + ring, ask);
      if (is_near(below, row + ring < cells.num_rows())) cells.for_each(row + ring, column - ring, column + ring, ask);
      if (is_near(left, column >= ring)) {
        for (int64_t r = row - ring + 1; r < row + ring; ++r) cells.for_each(r, column - ring, column - ring, ask);
      }
      if (is_near(right, column + ring < cells.num_columns())) {
        for (int64_t r = row - ring + 1; r < row + ring; ++r) cells.for_each(r, column + ring, column + ring, ask);
      }
    }
    const auto [votes, agree] = count(marker, farthest());
    return 2 * agree < std::min(votes, others);
  }

 private:
  struct Near {
    double distance;  // squared
    int32_t label;
  };

  // How many known markers are within a squared distance, and how many of them have the marker's label.
  std::pair<int64_t, int64_t> count(const Marker& marker, double limit) const {
    int64_t votes = 0, agree = 0;
    for (const Near& one : near_) {
      if (!(one.distance < limit)) break;
      ++votes, agree += one.label == marker.label;
    }
    return {votes, agree};
  }

  // Squared distance of the last marker; infinite while there are too few markers.
  double farthest() const {
    return near_.size() < most_ ? std::numeric_limits<double>::infinity() : near_.back().distance;
  }

  void take(const Marker& marker, const Marker& other) {
    const double down = other.row - marker.row, right = other.column - marker.column;
    const double limit = farthest();
    double distance = down * down + right * right;
    if (distance >= limit || distance == 0) return;  // 0: the marker itself
    distance = with_colors(distance, marker, other);
    if (distance >= limit) return;
    if (near_.size() == most_) near_.pop_back();
    size_t place = near_.size();
    near_.push_back({});
    for (; place > 0 && distance < near_[place - 1].distance; --place) near_[place] = near_[place - 1];
    near_[place] = {distance, other.label};
  }

  size_t most_;
  std::vector<Near> near_;  // nearest first
};

std::vector<Marker> markers_of(const int32_t* labels, const float* colors, int64_t height, int64_t width,
                               float color_weight) {
  std::vector<Marker> markers;
  const int64_t plane = height * width;
  for (int64_t i = 0; i < plane; ++i) {
    if (labels[i] < 0) continue;
    Marker marker{static_cast<int32_t>(i / width), static_cast<int32_t>(i % width), {}, labels[i]};
    for (int d = 0; d < 3; ++d) marker.color[d] = color_weight * colors[d * plane + i];
    markers.push_back(marker);
  }
  return markers;
}

// For each cell of an image, the lowest and the highest label in it and in its eight neighbours.
class LabelRanges {
 public:
  LabelRanges(const Cells& cells) : num_columns_(cells.num_columns()), range_(cells.num_rows() * num_columns_) {
    std::vector<Range> own(range_.size());
    for (int64_t row = 0; row < cells.num_rows(); ++row) {
      for (int64_t column = 0; column < num_columns_; ++column) {
        Range& range = own[row * num_columns_ + column];
        cells.for_each(row, column, column, [&](const Marker& marker) { range.take({marker.label, marker.label}); });
      }
    }
    for (int64_t row = 0; row < cells.num_rows(); ++row) {
      for (int64_t column = 0; column < num_columns_; ++column) {
        for (int64_t r = std::max<int64_t>(row - 1, 0); r <= std::min(row + 1, cells.num_rows() - 1); ++r) {
          for (int64_t c = std::max<int64_t>(column - 1, 0); c <= std::min(column + 1, num_columns_ - 1); ++c) {
            range_[row * num_columns_ + column].take(own[r * num_columns_ + c]);
          }
        }
      }
    }
  }

  bool differ(int64_t row, int64_t column) const {
    const Range& range = range_[row * num_columns_ + column];
    return range.low != range.high;
  }

 private:
  struct Range {
    int32_t low = std::numeric_limits<int32_t>::max(), high = -1;

    void take(const Range& other) { low = std::min(low, other.low), high = std::max(high, other.high); }
  };

  int64_t num_columns_;
  std::vector<Range> range_;
};

// The side of cells, pixels, from its length in mean distances of markers.
int64_t side_of(double distances, int64_t num_pixels, size_t num_markers) {
  const double side = std::ceil(distances * std::sqrt(static_cast<double>(num_pixels) / num_markers));
  return static_cast<int64_t>(std::min(std::max(side, 1.0), static_cast<double>(kMaxCount)));
}

Tensor outvoted_markers(const Tensor& markers, const Tensor& colors, double color_weight, int64_t num_voters,
                        double near) {
  const Tensor marker = checked_array(markers, ScalarType::Int, {-1, -1}, "markers");
  const int64_t height = marker.size(0), width = marker.size(1), num_pixels = height * width;
  check_image_size(height, width);
  const Tensor color = checked_array(colors, ScalarType::Float, {3, height, width}, "colors");
  check(color_weight >= 0 && color_weight <= kMaxWeight, "color_weight: expected 0 to 1000, got ", color_weight);
  check(num_voters >= 1 && num_voters <= kMaxCount, "num_voters: expected 1 to 2^31 - 1, got ", num_voters);
  check(std::isfinite(near) && near >= 0, "near: expected a finite number >= 0, got ", near);
  check_all(color.const_data_ptr<float>(), 3 * num_pixels, 0, 1, "colors: expected numbers in [0, 1]");

  Tensor outvoted = torch::stable::new_empty(marker, {height, width}, ScalarType::Bool);
  bool* const out = outvoted.mutable_data_ptr<bool>();
  std::fill_n(out, num_pixels, false);
  const auto all = markers_of(marker.const_data_ptr<int32_t>(), color.const_data_ptr<float>(), height, width,
                              static_cast<float>(color_weight));
  if (all.empty()) return outvoted;
  std::unordered_map<int32_t, int64_t> num_markers;
  for (const Marker& one : all) ++num_markers[one.label];
  const Cells wide(all, height, width, side_of(near, num_pixels, all.size()));
  const LabelRanges ranges(wide);
  const Cells cells(all, height, width, side_of(1, num_pixels, all.size()));
  Voters voters(std::min<int64_t>(num_voters, all.size()));
  for (const Marker& one : all) {
    if (!ranges.differ(wide.row_of(one), wide.column_of(one))) continue;
    out[one.row * width + one.column] = voters.outvote(cells, one, num_markers[one.label] - 1);
  }
  return outvoted;
}

}  // namespace

TORCHJOINT_OPERATOR(outvoted_markers,
                    "(Tensor markers, Tensor colors, float color_weight, SymInt num_voters, float near) -> Tensor");

}  // namespace torchjoint
