// Counts pairs of points that are close in an image, by the segments and labels of the two points. The pairs are never
// stored.
#include "common.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <tuple>
#include <unordered_map>
#include <utility>
#include <vector>

namespace torchjoint {
namespace {

struct Point {
  float u, v;
  int32_t pixel, segment, label;

  bool is_like(const Point& other) const { return segment == other.segment && label == other.label; }
};

// Lower and higher segment, lower and higher label of the two points of a pair.
using Group = std::array<int32_t, 4>;

struct GroupHash {
  size_t operator()(const Group& group) const {
    uint64_t hash = 0;
    for (const int32_t part : group) hash = (hash ^ static_cast<uint32_t>(part)) * 0x9e3779b97f4a7c15u;
    return hash ^ (hash >> 32);
  }
};

class Counts {
 public:
  void add(const Point& a, const Point& b) {
    const auto [low_segment, high_segment] = std::minmax(a.segment, b.segment);
    const auto [low_label, high_label] = std::minmax(a.label, b.label);
    const Group group{low_segment, high_segment, low_label, high_label};
    if (last_ == nullptr || last_->first != group) last_ = &*counts_.try_emplace(group, 0).first;
    ++last_->second;
  }

  std::vector<std::pair<Group, int64_t>> sorted() const {
    std::vector<std::pair<Group, int64_t>> result(counts_.begin(), counts_.end());
    std::sort(result.begin(), result.end());
    return result;
  }

 private:
  std::unordered_map<Group, int64_t, GroupHash> counts_;
  std::pair<const Group, int64_t>* last_ = nullptr;  // consecutive pairs are mostly in the same group
};

// Cells along one axis, at least as wide as the radius: two points within the radius are in equal or adjacent cells.
struct Axis {
  Axis(float low, float high, double radius, double most)
      : origin(low), side(std::max(radius * (1 + 1e-9), (static_cast<double>(high) - low) / most)),
        count(static_cast<int64_t>((static_cast<double>(high) - low) / side) + 1) {}

  int64_t cell(float position) const { return std::min(static_cast<int64_t>((position - origin) / side), count - 1); }

  double origin, side;
  int64_t count;
};

class Grid {
 public:
  Grid(const std::vector<Point>& points, double radius)
      : squared_radius_(radius * radius), across_(axis(points, &Point::u, radius)),
        down_(axis(points, &Point::v, radius)), starts_(across_.count * down_.count + 1), sorted_(points.size()) {
    for (const Point& point : points) ++starts_[cell(point)];
    int32_t start = 0;
    for (int32_t& count : starts_) start += std::exchange(count, start);
    for (const Point& point : points) sorted_[starts_[cell(point)]++] = point;
    for (size_t i = starts_.size() - 1; i > 0; --i) starts_[i] = starts_[i - 1];
    starts_[0] = 0;
    uniform_.resize(starts_.size() - 1);
    for (size_t i = 0; i < uniform_.size(); ++i) {
      uniform_[i] = std::all_of(begin(i), end(i), [&](const Point& p) { return p.is_like(*begin(i)); });
    }
  }

  void count_pairs(Counts& counts) const {
    for (int64_t y = 0; y < down_.count; ++y) {
      for (int64_t x = 0; x < across_.count; ++x) {
        const int64_t here = y * across_.count + x;
        if (begin(here) == end(here)) continue;
        if (!uniform_[here]) count_within(here, counts);
        if (x + 1 < across_.count) count_between(here, here + 1, counts);
        if (y + 1 == down_.count) continue;
        const int64_t below = here + across_.count;
        if (x > 0) count_between(here, below - 1, counts);
        count_between(here, below, counts);
        if (x + 1 < across_.count) count_between(here, below + 1, counts);
      }
    }
  }

 private:
  static Axis axis(const std::vector<Point>& points, float Point::* position, double radius) {
    const auto [low, high] = std::minmax_element(
        points.begin(), points.end(), [&](const Point& a, const Point& b) { return a.*position < b.*position; });
    // At most about four cells per point.
    return Axis((*low).*position, (*high).*position, radius, 2 * std::sqrt(static_cast<double>(points.size())));
  }

  int64_t cell(const Point& point) const { return down_.cell(point.v) * across_.count + across_.cell(point.u); }
  const Point* begin(int64_t cell) const { return sorted_.data() + starts_[cell]; }
  const Point* end(int64_t cell) const { return sorted_.data() + starts_[cell + 1]; }

  // The comparison that most pairs fail comes first.
  void count_pair(const Point& a, const Point& b, Counts& counts) const {
    if (a.is_like(b) || a.pixel == b.pixel) return;
    const double right = static_cast<double>(a.u) - b.u, below = static_cast<double>(a.v) - b.v;
    if (right * right + below * below <= squared_radius_) counts.add(a, b);
  }

  void count_within(int64_t cell, Counts& counts) const {
    for (const Point* a = begin(cell); a != end(cell); ++a) {
      for (const Point* b = a + 1; b != end(cell); ++b) count_pair(*a, *b, counts);
    }
  }

  void count_between(int64_t first, int64_t second, Counts& counts) const {
    if (begin(second) == end(second)) return;
    if (uniform_[first] && uniform_[second] && begin(first)->is_like(*begin(second))) return;
    for (const Point* a = begin(first); a != end(first); ++a) {
      for (const Point* b = begin(second); b != end(second); ++b) count_pair(*a, *b, counts);
    }
  }

  double squared_radius_;
  Axis across_, down_;
  std::vector<int32_t> starts_;  // of each cell, in sorted_
  std::vector<Point> sorted_;
  std::vector<char> uniform_;  // whether all points of a cell have the same segment and label
};

std::vector<Point> read_points(const float* u, const float* v, const int64_t* pixel, const int64_t* segment,
                               const int64_t* label, int64_t count) {
  std::vector<Point> points;
  points.reserve(count);
  for (int64_t i = 0; i < count; ++i) {
    check(std::isfinite(u[i]), "u: expected finite numbers, got ", u[i], " at ", i);
    check(std::isfinite(v[i]), "v: expected finite numbers, got ", v[i], " at ", i);
    check_index(pixel[i], kMaxCount, "pixel", i);
    check_index(label[i], kMaxCount, "label", i);
    if (segment[i] == -1) continue;
    check_index(segment[i], kMaxCount, "segment", i);
    points.push_back(
        {u[i], v[i], static_cast<int32_t>(pixel[i]), static_cast<int32_t>(segment[i]), static_cast<int32_t>(label[i])});
  }
  return points;
}

std::tuple<Tensor, Tensor> pair_counts(const Tensor& u, const Tensor& v, const Tensor& pixel, const Tensor& segment,
                                       const Tensor& label, double radius) {
  const Tensor us = checked_array(u, ScalarType::Float, {-1}, "u");
  const int64_t num_points = us.size(0);
  check(num_points <= kMaxCount, "u: expected fewer than 2^31 points, got ", num_points);
  const Tensor vs = checked_array(v, ScalarType::Float, {num_points}, "v");
  const Tensor pixels = checked_array(pixel, ScalarType::Long, {num_points}, "pixel");
  const Tensor segments = checked_array(segment, ScalarType::Long, {num_points}, "segment");
  const Tensor labels = checked_array(label, ScalarType::Long, {num_points}, "label");
  check(radius > 0 && std::isfinite(radius), "radius: expected a finite number > 0, got ", radius);

  const auto points =
      read_points(us.const_data_ptr<float>(), vs.const_data_ptr<float>(), pixels.const_data_ptr<int64_t>(),
                  segments.const_data_ptr<int64_t>(), labels.const_data_ptr<int64_t>(), num_points);
  Counts counts;
  if (!points.empty()) Grid(points, radius).count_pairs(counts);

  const auto groups = counts.sorted();
  const int64_t num_groups = static_cast<int64_t>(groups.size());
  Tensor group = torch::stable::new_empty(us, {4, num_groups}, ScalarType::Long);
  Tensor count = torch::stable::new_empty(us, {num_groups}, ScalarType::Long);
  int64_t* const group_out = group.mutable_data_ptr<int64_t>();
  int64_t* const count_out = count.mutable_data_ptr<int64_t>();
  for (int64_t g = 0; g < num_groups; ++g) {
    for (int64_t part = 0; part < 4; ++part) group_out[part * num_groups + g] = groups[g].first[part];
    count_out[g] = groups[g].second;
  }
  return {group, count};
}

}  // namespace

TORCHJOINT_OPERATOR(pair_counts,
                    "(Tensor u, Tensor v, Tensor pixel, Tensor segment, Tensor label, float radius) -> (Tensor "
                    "group, Tensor count)");

}  // namespace torchjoint
