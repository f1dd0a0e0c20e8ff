// Sums over images of how far two regions lie in the same image segments. Each pair of regions is handled by one thread,
// and all sums are of whole numbers, so the result depends neither on the threads nor on the order of the images.
#include "common.h"
#include "common_keys.h"

#include <cmath>
#include <span>
#include <tuple>
#include <vector>

namespace torchjoint {
namespace {

constexpr int64_t kRegionsAtOnce = 64, kPairsAtOnce = 64;

struct InSegment {
  int32_t key;  // image segment
  int32_t points;  // of the region in the segment
};

// A frame that sees enough points of a region.
struct InFrame {
  int32_t key;  // frame
  int32_t seen;  // points of the region that the frame sees
  std::span<const InSegment> segments;
};

struct Region {
  std::vector<InFrame> frames;
  double best = 0;  // overlap with an image segment, intersection over union
  int32_t too_small = -1;  // a segment that has fewer points than the region has in it
};

struct Segments {
  Segments(const Tensor& sizes, const Tensor& frames)
      : count(sizes.size(0)), size(sizes.const_data_ptr<int64_t>()), frame(frames.const_data_ptr<int64_t>()) {
    int64_t in_frame = 0;
    for (int64_t s = 0; s < count; ++s) {
      check_index(frame[s], kMaxCount, "frame_of_segment", s);
      check(s == 0 || frame[s] >= frame[s - 1], "frame_of_segment: expected ascending numbers, got ", frame[s], " at ",
            s);
      check_index(size[s], kMaxCount, "segment_size", s);
      in_frame = s > 0 && frame[s] == frame[s - 1] ? in_frame + size[s] : size[s];
      check(in_frame <= kMaxCount, "segment_size: expected at most 2^31 - 1 points in a frame, got ", in_frame);
    }
  }

  int64_t count;
  const int64_t *size, *frame;
};

class Regions {
 public:
  Regions(const int32_t* region, const int32_t* segment, const int32_t* points, int64_t num_rows,
          const Segments& segments, int64_t num_regions, int64_t min_points)
      : segments_(segments), min_points_(min_points), regions_(num_regions) {
    std::vector<int64_t> start(num_regions + 1);
    for (int64_t i = 0; i < num_rows; ++i) {
      check_index(region[i], num_regions, "region", i);
      check_index(segment[i], segments.count, "segment", i);
      check(points[i] >= 0, "num_points: expected numbers >= 0, got ", points[i], " at ", i);
      ++start[region[i] + 1];
    }
    for (int64_t r = 0; r < num_regions; ++r) start[r + 1] += start[r];
    rows_.resize(num_rows);
    for (int64_t i = 0; i < num_rows; ++i) rows_[start[region[i]]++] = {segment[i], points[i]};
    // Now start[r] is the end of region r.
    parallel_for_each(num_regions, kRegionsAtOnce, [&](int64_t r) {
      const int64_t first = r == 0 ? 0 : start[r - 1];
      summarize(std::span(rows_).subspan(first, start[r] - first), regions_[r]);
    });
    for (int64_t r = 0; r < num_regions; ++r) {  // an exception from a thread would lose its text
      check(regions_[r].too_small < 0, "num_points: expected at most segment_size, but region ", r,
            " has more points in segment ", regions_[r].too_small);
    }
  }

  const Region& operator[](int64_t region) const { return regions_[region]; }

 private:
  // Sorts the rows of a region, adds those of one segment, and splits them by frames.
  void summarize(std::span<InSegment> rows, Region& region) const {
    const auto is_before = [](const InSegment& a, const InSegment& b) { return a.key < b.key; };
    if (!std::is_sorted(rows.begin(), rows.end(), is_before)) std::sort(rows.begin(), rows.end(), is_before);
    size_t begin = 0, count = 0;  // of the rows of the frame, in the front of `rows`
    int64_t seen = 0;
    for (size_t i = 0; i < rows.size();) {
      const int32_t segment = rows[i].key;
      int64_t points = 0;
      for (; i < rows.size() && rows[i].key == segment; ++i) points += rows[i].points;
      if (points > segments_.size[segment]) {
        region.too_small = segment;
        return;
      }
      rows[count++] = {segment, static_cast<int32_t>(points)};
      seen += points;
      if (i < rows.size() && segments_.frame[rows[i].key] == segments_.frame[segment]) continue;
      if (seen >= min_points_) add_frame(rows.subspan(begin, count - begin), seen, region);
      begin = count;
      seen = 0;
    }
  }

  void add_frame(std::span<const InSegment> rows, int64_t seen, Region& region) const {
    region.frames.push_back({static_cast<int32_t>(segments_.frame[rows[0].key]), static_cast<int32_t>(seen), rows});
    for (const InSegment& row : rows) {
      const int64_t unions = seen + segments_.size[row.key] - row.points;
      region.best = std::max(region.best, static_cast<double>(row.points) / static_cast<double>(unions));
    }
  }

  const Segments& segments_;
  const int64_t min_points_;
  std::vector<InSegment> rows_;
  std::vector<Region> regions_;
};

// What all images say about two regions.
struct Evidence {
  double best_union = 0, low = std::numeric_limits<double>::infinity(), high = -low;
  uint64_t common = 0, product = 0, rounded = 0, squares = 0, views = 0;  // unsigned numbers may overflow

  Evidence(const Segments& segments, const Region& one, const Region& other, double resolution) {
    for_each_common<InFrame>(one.frames, other.frames, [&](const InFrame& a, const InFrame& b) {
      const uint64_t pairs = product_of(a.seen, b.seen), in_common = compare(segments, a, b);
      const double agreement = static_cast<double>(in_common) / static_cast<double>(pairs);
      const uint64_t steps = static_cast<uint64_t>(std::nearbyint(agreement / resolution));
      common += in_common;
      product += pairs;
      rounded += steps;
      squares += steps * steps;
      ++views;
      low = std::min(low, agreement);
      high = std::max(high, agreement);
    });
  }

 private:
  static uint64_t product_of(int32_t a, int32_t b) { return static_cast<uint64_t>(a) * static_cast<uint64_t>(b); }

  // Returns the agreement in a frame, times the product of the points that it sees.
  uint64_t compare(const Segments& segments, const InFrame& one, const InFrame& other) {
    uint64_t in_common = 0;
    for_each_common<InSegment>(one.segments, other.segments, [&](const InSegment& a, const InSegment& b) {
      in_common += std::min(product_of(a.points, other.seen), product_of(b.points, one.seen));
      const int64_t both = int64_t{a.points} + b.points;
      const int64_t all = int64_t{one.seen} + other.seen + segments.size[a.key] - both;
      best_union = std::max(best_union, static_cast<double>(both) / static_cast<double>(all));
    });
    return in_common;
  }
};

std::tuple<Tensor, Tensor, Tensor> agreement_sums(const Tensor& region, const Tensor& segment, const Tensor& num_points,
                                                  const Tensor& segment_size, const Tensor& frame_of_segment,
                                                  int64_t num_regions, const Tensor& pairs, int64_t min_points,
                                                  double resolution) {
  const Tensor regions_of_rows = checked_array(region, ScalarType::Int, {-1}, "region");
  const int64_t num_rows = regions_of_rows.size(0);
  const Tensor of_rows = checked_array(segment, ScalarType::Int, {num_rows}, "segment");
  const Tensor points = checked_array(num_points, ScalarType::Int, {num_rows}, "num_points");
  const Tensor sizes = checked_array(segment_size, ScalarType::Long, {-1}, "segment_size");
  const Tensor frames = checked_array(frame_of_segment, ScalarType::Long, {sizes.size(0)}, "frame_of_segment");
  check(num_regions >= 0 && num_regions <= kMaxCount, "num_regions: expected 0 to 2^31 - 1, got ", num_regions);
  const Tensor ends = checked_array(pairs, ScalarType::Long, {2, -1}, "pairs");
  const int64_t num_pairs = ends.size(1);
  check(min_points > 0, "min_points: expected a number > 0, got ", min_points);
  check(resolution >= 0x1p-31 && resolution <= 1, "resolution: expected a number in [2^-31, 1], got ", resolution);
  const int64_t* const end = ends.const_data_ptr<int64_t>();
  for (int64_t i = 0; i < 2 * num_pairs; ++i) check_index(end[i], num_regions, "pairs", i);
  const Segments segments(sizes, frames);
  const Regions regions(regions_of_rows.const_data_ptr<int32_t>(), of_rows.const_data_ptr<int32_t>(),
                        points.const_data_ptr<int32_t>(), num_rows, segments, num_regions, min_points);

  Tensor best = torch::stable::new_empty(sizes, {num_regions}, ScalarType::Double);
  Tensor extremes = torch::stable::new_empty(sizes, {3, num_pairs}, ScalarType::Double);
  Tensor sums = torch::stable::new_empty(sizes, {5, num_pairs}, ScalarType::Long);
  double* const best_out = best.mutable_data_ptr<double>();
  for (int64_t r = 0; r < num_regions; ++r) best_out[r] = regions[r].best;
  double* const extreme = extremes.mutable_data_ptr<double>();
  int64_t* const sum = sums.mutable_data_ptr<int64_t>();
  parallel_for_each(num_pairs, kPairsAtOnce, [&](int64_t i) {
    const Evidence found(segments, regions[end[i]], regions[end[num_pairs + i]], resolution);
    int64_t row = 0;
    for (const double value : {found.best_union, found.low, found.high}) extreme[row++ * num_pairs + i] = value;
    row = 0;
    for (const uint64_t value : {found.common, found.product, found.rounded, found.squares, found.views}) {
      sum[row++ * num_pairs + i] = static_cast<int64_t>(value);
    }
  });
  return {best, extremes, sums};
}

}  // namespace

TORCHJOINT_OPERATOR(agreement_sums,
                    "(Tensor region, Tensor segment, Tensor num_points, Tensor segment_size, Tensor "
                    "frame_of_segment, SymInt num_regions, Tensor pairs, int min_points, float resolution) -> "
                    "(Tensor best, Tensor extremes, Tensor sums)");

}  // namespace torchjoint
