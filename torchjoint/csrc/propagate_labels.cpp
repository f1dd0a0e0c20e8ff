// Geodesic label propagation: every pixel takes the label of the marker with the cheapest path to the pixel.
#include "array.h"
#include "common.h"

#include <array>
#include <cmath>

namespace torchjoint {
namespace {

// Costs are whole numbers, this many per pixel width, so that equal costs compare as equal. No step costs less.
constexpr int32_t kUnits = 8;
constexpr double kMaxWeight = 1000;
constexpr float kDiagonal = 1.41421356f;

// A pixel's cheapest path so far, in one number: the cost in the upper bits, the label in the lower bits. So the lower
// label wins a tie.
using Path = uint64_t;
constexpr int kCostShift = 32;
constexpr Path kFar = std::numeric_limits<Path>::max();
// The value of the margin around the image: it has no label, and no path is cheaper.
constexpr Path kMargin = std::numeric_limits<uint32_t>::max();

Path path_of(int32_t label) { return static_cast<uint32_t>(label); }
int32_t label_of(Path path) { return static_cast<int32_t>(static_cast<uint32_t>(path)); }
int64_t cost_of(Path path) { return static_cast<int64_t>(path >> kCostShift); }

// Costs of the steps from a pixel to the right, down, down and right, and down and left.
using Steps = std::array<uint16_t, 4>;

// Rows of an image: three colours and the boundary strength.
struct Rows {
  const float *red, *green, *blue, *strength;
};

struct Weights {
  float color, boundary;
};

// Costs of the steps from pixels first, ..., last - 1 of a row to the pixels `right` columns further, in any row.
void step_costs(const Rows& from, const Rows& to, int64_t right, int64_t first, int64_t last, float length,
                Weights weights, float* cost) {
  constexpr float kRound = 12582912;  // adding it leaves no bits for a fraction: rounds half to even
  for (int64_t x = first; x < last; ++x) {
    const int64_t there = x + right;
    const float red = from.red[x] - to.red[there], green = from.green[x] - to.green[there];
    const float blue = from.blue[x] - to.blue[there];
    const float distance = std::sqrt(red * red + green * green + blue * blue);
    const float boundary = std::min(from.strength[x], to.strength[there]);
    cost[x] = (kUnits * (length + weights.color * distance + weights.boundary * boundary) + kRound) - kRound;
  }
}

// Dijkstra's algorithm with buckets of costs (Dial 1969). A bucket is as wide as the cheapest step, so the paths in it
// are final, in any order. The image has a margin of one pixel, which no path enters.
class LabelPropagation {
 public:
  LabelPropagation(int64_t height, int64_t width, Weights weights)
      : height_(height), width_(width), stride_(width + 2), steps_((height + 2) * stride_),
        path_((height + 2) * stride_), weights_(weights),
        buckets_(static_cast<size_t>(kDiagonal + 1.7320509f * weights.color + weights.boundary) + 4) {
    std::fill_n(path_.data(), path_.size(), kMargin);
    std::fill_n(steps_.data(), steps_.size(), Steps{kUnits, kUnits, kUnits, kUnits});  // so that none enters the margin
  }

  // Sets the costs of all steps, from planes [height, width].
  void set_costs(const float* colors, const float* strength) {
    const int64_t plane = height_ * width_;
    const auto rows = [&](int64_t row) {
      const float* const red = colors + row * width_;
      return Rows{red, red + plane, red + 2 * plane, strength + row * width_};
    };
    std::array<std::vector<float>, 4> cost;
    for (std::vector<float>& line : cost) line.assign(width_, kUnits);
    for (int64_t row = 0; row < height_; ++row) {
      const Rows here = rows(row);
      step_costs(here, here, 1, 0, width_ - 1, 1, weights_, cost[0].data());
      if (row + 1 < height_) {
        const Rows below = rows(row + 1);
        step_costs(here, below, 0, 0, width_, 1, weights_, cost[1].data());
        step_costs(here, below, 1, 0, width_ - 1, kDiagonal, weights_, cost[2].data());
        step_costs(here, below, -1, 1, width_, kDiagonal, weights_, cost[3].data());
      }
      Steps* const out = &steps_[place(row, 0)];
      for (int64_t x = 0; x < width_; ++x) {
        for (int step = 0; step < 4; ++step) out[x][step] = static_cast<uint16_t>(static_cast<int32_t>(cost[step][x]));
      }
    }
  }

  // Labels all pixels from the markers, which are the labels >= 0; there must be at least one.
  void run(const int32_t* markers) {
    for_each_pixel([&](int64_t pixel, int64_t here) {
      path_[here] = kFar;
      if (markers[pixel] >= 0) reach(here, path_of(markers[pixel]));
    });
    spread();
  }

  // Labels the connected parts that contain fewer markers than `least` again, from the other parts. Labels of one group
  // are in one part; without groups each label is one.
  void settle_specks(const int32_t* markers, int64_t least, const int32_t* groups) {
    std::vector<int32_t> root;
    const Array<int32_t> part = parts(root, groups);
    std::vector<int64_t> count(root.size());
    for_each_pixel([&](int64_t pixel, int64_t here) {
      if (markers[pixel] >= 0) ++count[root[part[here]]];
    });
    std::vector<uint8_t> stays(root.size());
    for (size_t i = 0; i < root.size(); ++i) stays[i] = count[root[i]] >= least;
    const auto num_stay = static_cast<size_t>(std::count(stays.begin(), stays.end(), 1));
    if (num_stay == 0 || num_stay == stays.size()) return;
    for_each_pixel(
        [&](int64_t, int64_t here) { path_[here] = stays[part[here]] ? path_of(label_of(path_[here])) : kFar; });
    for_each_pixel([&](int64_t, int64_t here) {
      if (path_[here] != kFar) return;
      for (const int64_t offset :
           {-stride_ - 1, -stride_, -stride_ + 1, int64_t{-1}, int64_t{1}, stride_ - 1, stride_, stride_ + 1}) {
        const Path next = path_[here + offset];
        if (next != kFar && next != kMargin) reach(here + offset, next);
      }
    });
    spread();
  }

  void copy_labels(int32_t* labels) const {
    for_each_pixel([&](int64_t pixel, int64_t here) { labels[pixel] = label_of(path_[here]); });
  }

 private:
  int64_t place(int64_t row, int64_t x) const { return (row + 1) * stride_ + x + 1; }

  template <typename Function>
  void for_each_pixel(Function&& function) const {
    for (int64_t row = 0; row < height_; ++row) {
      for (int64_t x = 0; x < width_; ++x) function(row * width_ + x, place(row, x));
    }
  }

  void reach(int64_t here, Path path) {
    path_[here] = path;
    buckets_[cost_of(path) / kUnits % buckets_.size()].push_back(static_cast<int32_t>(here));
    ++waiting_;
  }

  void spread() {
    for (int64_t number = 0; waiting_ > 0; ++number) {
      std::vector<int32_t>& bucket = buckets_[number % buckets_.size()];
      waiting_ -= bucket.size();
      for (const int32_t here : bucket) {
        if (cost_of(path_[here]) / kUnits == number) leave(here);  // else a cheaper path was found later
      }
      bucket.clear();
    }
  }

  void leave(int64_t here) {
    const Path path = path_[here];
    const Steps& own = steps_[here];
    step(path, own[0], here + 1);
    step(path, own[1], here + stride_);
    step(path, own[2], here + stride_ + 1);
    step(path, own[3], here + stride_ - 1);
    step(path, steps_[here - 1][0], here - 1);
    step(path, steps_[here - stride_][1], here - stride_);
    step(path, steps_[here - stride_ - 1][2], here - stride_ - 1);
    step(path, steps_[here - stride_ + 1][3], here - stride_ + 1);
  }

  void step(Path path, uint16_t cost, int64_t next) {
    const Path there = path + (static_cast<Path>(cost) << kCostShift);
    if (there >= path_[next]) return;
    if (cost_of(there) < cost_of(path_[next])) {
      reach(next, there);
    } else {
      path_[next] = there;  // the lower label; the pixel is already in a bucket
    }
  }

  // A number for each pixel. Pixels are connected by one group (8-neighbourhood) if their numbers have one root.
  Array<int32_t> parts(std::vector<int32_t>& parent, const int32_t* groups) const {
    Array<int32_t> part(path_.size());
    const auto find = [&](int32_t number) {
      while (parent[number] != number) number = parent[number] = parent[parent[number]];
      return number;
    };
    const auto group = [&](int64_t pixel) {
      const int32_t label = label_of(path_[pixel]);
      return groups != nullptr && label >= 0 ? groups[label] : label;
    };
    for_each_pixel([&](int64_t, int64_t here) {
      const auto same = [&](int64_t there) { return group(there) == group(here); };
      const int64_t left = here - 1, above = here - stride_, corner = above + 1;
      // Pixels above are already in one part with their own neighbours, so at most two of the four need a test.
      int64_t first = same(left) ? left : above - 1;
      if (same(above)) first = above;
      if (!same(above) && same(corner)) {
        if (same(first)) parent[find(part[first])] = find(part[corner]);
        first = corner;
      }
      if (same(first)) {
        part[here] = part[first];
      } else {
        part[here] = static_cast<int32_t>(parent.size());
        parent.push_back(part[here]);
      }
    });
    for (int32_t& number : parent) number = find(number);
    return part;
  }

  const int64_t height_, width_, stride_;
  Array<Steps> steps_;
  Array<Path> path_;
  const Weights weights_;
  std::vector<std::vector<int32_t>> buckets_;
  int64_t waiting_ = 0;
};

Tensor propagate_labels(const Tensor& markers, const Tensor& colors, const Tensor& boundary, double color_weight,
                        double boundary_weight, int64_t min_markers, const std::optional<Tensor>& groups) {
  const Tensor marker = checked_array(markers, ScalarType::Int, {-1, -1}, "markers");
  const int64_t height = marker.size(0), width = marker.size(1), num_pixels = height * width;
  check_image_size(height, width);
  const Tensor color = checked_array(colors, ScalarType::Float, {3, height, width}, "colors");
  const Tensor boundaries = checked_array(boundary, ScalarType::Float, {height, width}, "boundary");
  check(color_weight >= 0 && color_weight <= kMaxWeight, "color_weight: expected 0 to 1000, got ", color_weight);
  check(boundary_weight >= 0 && boundary_weight <= kMaxWeight, "boundary_weight: expected 0 to 1000, got ",
        boundary_weight);
  check(min_markers >= 0, "min_markers: expected a number >= 0, got ", min_markers);
  // The cheapest path costs at most as much as a straight path. A straight path has fewer steps than this limit, and
  // each step costs less than 2^15, so the sum fits into 32 bits.
  check(std::max(height, width) < (1 << 16), "markers: expected sides of fewer than 2^16 pixels, got ", height, " x ",
        width);
  check((height + 2) * (width + 2) <= kMaxCount, "markers: expected fewer than 2^31 pixels with a margin of one, got ",
        height, " x ", width);
  check_all(color.const_data_ptr<float>(), 3 * num_pixels, 0, 1, "colors: expected numbers in [0, 1]");
  check_all(boundaries.const_data_ptr<float>(), num_pixels, 0, 1, "boundary: expected numbers in [0, 1]");

  Tensor labels = torch::stable::new_empty(marker, {height, width}, ScalarType::Int);
  const int32_t* const given = marker.const_data_ptr<int32_t>();
  std::optional<Tensor> group;
  if (groups) {
    group = checked_array(*groups, ScalarType::Int, {-1}, "groups");
    const int32_t* const number = group->const_data_ptr<int32_t>();
    check(num_pixels == 0 || *std::max_element(given, given + num_pixels) < group->size(0),
          "groups: expected one for each label of a marker, got ", group->size(0));
    check(std::all_of(number, number + group->size(0), [](int32_t one) { return one >= 0; }),
          "groups: expected numbers >= 0, got a negative one");
  }
  int32_t* const out = labels.mutable_data_ptr<int32_t>();
  if (std::all_of(given, given + num_pixels, [](int32_t label) { return label < 0; })) {
    std::copy_n(given, num_pixels, out);
    return labels;
  }
  LabelPropagation propagation(height, width, {static_cast<float>(color_weight), static_cast<float>(boundary_weight)});
  propagation.set_costs(color.const_data_ptr<float>(), boundaries.const_data_ptr<float>());
  propagation.run(given);
  if (min_markers > 1)
    propagation.settle_specks(given, min_markers, group ? group->const_data_ptr<int32_t>() : nullptr);
  propagation.copy_labels(out);
  return labels;
}

}  // namespace

TORCHJOINT_OPERATOR(propagate_labels,
                    "(Tensor markers, Tensor colors, Tensor boundary, float color_weight, float boundary_weight, int "
                    "min_markers=1, Tensor? groups=None) -> Tensor");

}  // namespace torchjoint
