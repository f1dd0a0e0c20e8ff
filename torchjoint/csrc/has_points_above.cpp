// Whether something rises from points: whether the cells of a grid around a point hold a point that is a little higher.
#include "common.h"

#include <cmath>

namespace torchjoint {
namespace {

constexpr int64_t kPointsAtOnce = 1 << 12, kCellsAtOnce = 1 << 10;

// The heights of points by their cells, ascending in each cell. Columns are a circle, rows a line.
class Grid {
 public:
  Grid(const int64_t* column, const int64_t* row, const double* height, const bool* used, int64_t count,
       int64_t num_columns, int64_t num_rows)
      : num_columns_(num_columns), num_rows_(num_rows), start_(num_columns * num_rows + 1) {
    for (int64_t i = 0; i < count; ++i) {
      if (used[i]) ++start_[cell(column[i], row[i]) + 1];
    }
    for (size_t i = 1; i < start_.size(); ++i) start_[i] += start_[i - 1];
    heights_.resize(start_.back());
    std::vector<int32_t> next(start_.begin(), start_.end() - 1);
    for (int64_t i = 0; i < count; ++i) {
      if (used[i]) heights_[next[cell(column[i], row[i])]++] = height[i];
    }
    parallel_for_each(num_columns * num_rows, kCellsAtOnce,
                      [&](int64_t i) { std::sort(heights_.begin() + start_[i], heights_.begin() + start_[i + 1]); });
  }

  // Whether a point of these cells is more than `least` and less than `most` above a height.
  bool rises(int64_t column, int64_t row, double low, double least, double most) const {
    for (const int64_t side : {num_columns_ - 1, int64_t{0}, int64_t{1}}) {
      for (int64_t near = std::max<int64_t>(row - 1, 0); near <= std::min(row + 1, num_rows_ - 1); ++near) {
        const int64_t at = cell((column + side) % num_columns_, near);
        const auto end = heights_.begin() + start_[at + 1];
        const auto over = std::partition_point(heights_.begin() + start_[at], end,
                                               [&](double height) { return !(height - low > least); });
        if (over != end && *over - low < most) return true;
      }
    }
    return false;
  }

 private:
  int64_t cell(int64_t column, int64_t row) const { return column * num_rows_ + row; }

  const int64_t num_columns_, num_rows_;
  std::vector<int32_t> start_;  // of each cell
  std::vector<double> heights_;
};

Tensor has_points_above(const Tensor& column, const Tensor& row, const Tensor& height, const Tensor& used,
                        const Tensor& which, int64_t num_columns, int64_t num_rows, double least, double most) {
  const Tensor columns = checked_array(column, ScalarType::Long, {-1}, "column");
  const int64_t count = columns.size(0);
  check(count <= kMaxCount, "column: expected at most 2^31 - 1 points, got ", count);
  const Tensor rows = checked_array(row, ScalarType::Long, {count}, "row");
  const Tensor heights = checked_array(height, ScalarType::Double, {count}, "height");
  const Tensor may = checked_array(used, ScalarType::Bool, {count}, "used");
  const Tensor tested = checked_array(which, ScalarType::Long, {-1}, "which");
  check(num_columns > 0 && num_columns <= kMaxCount, "num_columns: expected a number > 0, got ", num_columns);
  check(num_rows >= 0 && num_rows <= kMaxCount / num_columns, "num_rows: expected less than 2^31 cells, got ", num_rows,
        " rows");
  const int64_t *c = columns.const_data_ptr<int64_t>(), *r = rows.const_data_ptr<int64_t>();
  const double* h = heights.const_data_ptr<double>();
  for (int64_t i = 0; i < count; ++i) {
    check_index(c[i], num_columns, "column", i);
    check_index(r[i], num_rows, "row", i);
    check(std::isfinite(h[i]), "height: expected finite numbers, got ", h[i], " at ", i);
  }
  const int64_t* const points = tested.const_data_ptr<int64_t>();
  const int64_t num_tested = tested.size(0);
  for (int64_t i = 0; i < num_tested; ++i) check_index(points[i], count, "which", i);
  const Grid grid(c, r, h, may.const_data_ptr<bool>(), count, num_columns, num_rows);
  Tensor found = torch::stable::new_empty(tested, {num_tested}, ScalarType::Bool);
  bool* const rises = found.mutable_data_ptr<bool>();
  parallel_for_each(num_tested, kPointsAtOnce,
                    [&](int64_t i) { rises[i] = grid.rises(c[points[i]], r[points[i]], h[points[i]], least, most); });
  return found;
}

}  // namespace

TORCHJOINT_OPERATOR(has_points_above,
                    "(Tensor column, Tensor row, Tensor height, Tensor used, Tensor which, int num_columns, int "
                    "num_rows, float least, float most) -> Tensor");

}  // namespace torchjoint
