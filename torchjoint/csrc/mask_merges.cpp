// Region merging by the agreement of masks: the two regions with the lowest cost merge first. The cost of a boundary
// is the share of masks that separate its regions, over all views, with a prior for regions that few views see together.
#include <cmath>
#include <functional>
#include <map>
#include <queue>
#include <tuple>
#include <utility>
#include <vector>

#include "common_keys.h"
#include "merged_regions.h"

namespace torchjoint {
namespace {

// Weights of masks are whole numbers up to this, so that all sums are exact.
constexpr int64_t kWeightUnit = 256;

struct InMask {
  int64_t key;  // mask
  int64_t points;  // of the region in the mask
};

struct InFrame {
  int64_t key;  // frame
  int64_t seen;  // points of the region that the frame sees
  int64_t covered;  // sum over the frame's masks of their weight times the region's points in them
};

// The union of two lists with ascending keys; the items of common keys are added.
template <typename Item, typename Add>
std::vector<Item> united(const std::vector<Item>& one, const std::vector<Item>& other, const Add& add) {
  std::vector<Item> result;
  result.reserve(one.size() + other.size());
  auto a = one.begin(), b = other.begin();
  while (a != one.end() || b != other.end()) {
    if (b == other.end() || (a != one.end() && a->key < b->key)) {
      result.push_back(*a++);
    } else if (a == one.end() || b->key < a->key) {
      result.push_back(*b++);
    } else {
      result.push_back(add(*a++, *b++));
    }
  }
  return result;
}

// The evidence of the frames about a region. Sums of whole numbers do not depend on the order of the terms.
struct Views {
  std::vector<InMask> masks;
  std::vector<InFrame> frames;

  void add(const Views& other) {
    masks =
        united(masks, other.masks, [](const InMask& a, const InMask& b) { return InMask{a.key, a.points + b.points}; });
    frames = united(frames, other.frames, [](const InFrame& a, const InFrame& b) {
      return InFrame{a.key, a.seen + b.seen, a.covered + b.covered};
    });
  }
};

// Sums over all pairs of points, one of each region, that one frame sees. First: twice the weights of the masks that
// contain both points. Second: this, plus the weights of the masks that contain one of them.
struct Agreement {
  int64_t agree = 0, total = 0;

  void add(const Views& one, const Views& other, const int64_t* weight) {
    for_each_common<InMask>(one.masks, other.masks, [&](const InMask& a, const InMask& b) {
      agree += 2 * weight[a.key] * a.points * b.points;
    });
    for_each_common<InFrame>(one.frames, other.frames, [&](const InFrame& a, const InFrame& b) {
      total += a.covered * b.seen + b.covered * a.seen;
    });
  }
};

struct Border {
  int32_t region[2];
  int64_t prior_sum = 0, prior_count = 0;  // costs of the edges that cross it
  Agreement views;
  int32_t version = 0;
  bool is_gone = false;
};

class MaskGraph {
 public:
  MaskGraph(std::vector<Views> views, const int64_t* size, const int64_t* weight, double apart_weight,
            double prior_weight, const bool* stays, int64_t min_size)
      : views_(std::move(views)), size_(size, size + views_.size()), border_to_(views_.size()), weight_(weight),
        apart_weight_(apart_weight), prior_weight_(prior_weight), stays_(stays, stays + views_.size()),
        min_size_(min_size) {}

  void add_edges(int32_t a, int32_t b, int64_t cost, int64_t count) {
    const auto [place, is_new] = border_to_[a].try_emplace(b, static_cast<int32_t>(borders_.size()));
    if (is_new) {
      border_to_[b].emplace(a, place->second);
      borders_.push_back({.region = {a, b}, .views = {}});
    }
    borders_[place->second].prior_sum += cost * count;
    borders_[place->second].prior_count += count;
  }

  // Calls `on_merge(a, b, cost)` before each merge of two regions.
  template <typename OnMerge>
  void merge_all(double threshold, const OnMerge& on_merge) {
    for (size_t number = 0; number < borders_.size(); ++number) {
      Border& border = borders_[number];
      border.views.add(views_[border.region[0]], views_[border.region[1]], weight_);
      wait(static_cast<int32_t>(number), threshold);
    }
    while (!waiting_.empty()) {
      const auto [cost, number, version] = waiting_.top();
      waiting_.pop();
      const Border& border = borders_[number];
      if (border.is_gone || border.version != version) continue;
      on_merge(border.region[0], border.region[1], cost);
      merge(number, threshold);
    }
  }

 private:
  using Waiting = std::tuple<double, int32_t, int32_t>;  // cost, number and version of a border

  double cost_of(const Border& border) const {
    const double pairs =
        2.0 * kWeightUnit * static_cast<double>(size_[border.region[0]]) * static_cast<double>(size_[border.region[1]]);
    const double together = static_cast<double>(border.views.agree) / pairs;
    const double apart = apart_weight_ * (static_cast<double>(border.views.total - border.views.agree) / pairs);
    const double prior = static_cast<double>(border.prior_sum) / static_cast<double>(border.prior_count) / kUnit;
    return (apart + prior_weight_ * prior) / (together + apart + prior_weight_);
  }

  bool is_small(int32_t region) const { return size_[region] < min_size_ && !stays_[region]; }

  void wait(int32_t number, double threshold) {
    Border& border = borders_[number];
    ++border.version;
    if (min_size_ > 0 && !is_small(border.region[0]) && !is_small(border.region[1])) return;
    const double cost = cost_of(border);
    if (cost <= threshold) waiting_.emplace(cost, number, border.version);
  }

  // The region with fewer borders passes its borders to the other region. All sums are linear in the regions' points, so
  // each border only adds the terms of the other region.
  void merge(int32_t number, double threshold) {
    auto [kept, given] = borders_[number].region;
    if (border_to_[kept].size() < border_to_[given].size()) std::swap(kept, given);
    borders_[number].is_gone = true;
    border_to_[kept].erase(given);
    border_to_[given].erase(kept);
    const std::map<int32_t, int32_t> moving = std::move(border_to_[given]);
    border_to_[given].clear();
    for (const auto& [other, border] : border_to_[kept]) {
      if (!moving.contains(other)) borders_[border].views.add(views_[given], views_[other], weight_);
    }
    for (const auto& [other, moved] : moving) move(moved, kept, given, other);
    size_[kept] += size_[given];
    stays_[kept] = stays_[kept] || stays_[given];
    views_[kept].add(views_[given]);
    views_[given] = {};
    for (const auto& [other, border] : border_to_[kept]) wait(border, threshold);
  }

  // Makes a border between the regions `given` and `other` one between `kept` and `other`.
  void move(int32_t moved, int32_t kept, int32_t given, int32_t other) {
    border_to_[other].erase(given);
    const auto [place, is_new] = border_to_[kept].try_emplace(other, moved);
    if (is_new) {
      borders_[moved].views.add(views_[kept], views_[other], weight_);
    } else {
      Border& stays = borders_[std::min(place->second, moved)];
      Border& goes = borders_[std::max(place->second, moved)];
      stays.prior_sum += goes.prior_sum;
      stays.prior_count += goes.prior_count;
      stays.views.agree += goes.views.agree;
      stays.views.total += goes.views.total;
      goes.is_gone = true;
      place->second = std::min(place->second, moved);
    }
    border_to_[other][kept] = place->second;
    borders_[place->second].region[0] = kept;
    borders_[place->second].region[1] = other;
  }

  std::vector<Border> borders_;
  std::vector<Views> views_;
  std::vector<int64_t> size_;
  std::vector<std::map<int32_t, int32_t>> border_to_;  // of each region: numbers of its borders, by the other region
  const int64_t* weight_;
  double apart_weight_, prior_weight_;
  std::vector<uint8_t> stays_;
  int64_t min_size_;
  std::priority_queue<Waiting, std::vector<Waiting>, std::greater<>> waiting_;
};

// Reads and checks the evidence of the frames about the regions. Entries may have any order; equal ones are added.
std::vector<Views> read_views(const Tensor& in_mask, const Tensor& in_frame, const Tensor& frame_of_mask,
                              const int64_t* weight, int64_t num_masks, int64_t num_regions) {
  const int64_t num_in_mask = in_mask.size(1), num_in_frame = in_frame.size(1);
  const int64_t* const mask = in_mask.const_data_ptr<int64_t>();
  const int64_t* const frame = in_frame.const_data_ptr<int64_t>();
  const int64_t* const frame_of = frame_of_mask.const_data_ptr<int64_t>();
  std::vector<std::map<int64_t, int64_t>> points(num_regions);
  std::vector<std::map<int64_t, InFrame>> frames(num_regions);
  for (int64_t j = 0; j < num_in_frame; ++j) {
    check_index(frame[j], num_regions, "in_frame[0]", j);
    check(frame[2 * num_in_frame + j] >= 0, "in_frame[2]: expected numbers >= 0, got ", frame[2 * num_in_frame + j]);
    const int64_t key = frame[num_in_frame + j];
    InFrame& item = frames[frame[j]].try_emplace(key, InFrame{key, 0, 0}).first->second;
    item.seen += frame[2 * num_in_frame + j];
  }
  for (int64_t i = 0; i < num_in_mask; ++i) {
    const int64_t region = mask[i], key = mask[num_in_mask + i], count = mask[2 * num_in_mask + i];
    check_index(region, num_regions, "in_mask[0]", i);
    check_index(key, num_masks, "in_mask[1]", i);
    check(count >= 0, "in_mask[2]: expected numbers >= 0, got ", count, " at ", i);
    const auto seen = frames[region].find(frame_of[key]);
    check(seen != frames[region].end(), "in_mask: region ", region, " has points in mask ", key,
          ", but in_frame has none in frame ", frame_of[key]);
    seen->second.covered += weight[key] * count;
    check((points[region][key] += count) <= seen->second.seen, "in_mask: region ", region, " has more points in mask ",
          key, " than in its frame");
  }
  std::vector<Views> views(num_regions);
  for (int64_t region = 0; region < num_regions; ++region) {
    for (const auto& [key, count] : points[region]) views[region].masks.push_back({key, count});
    for (const auto& [key, item] : frames[region]) views[region].frames.push_back(item);
  }
  return views;
}

std::tuple<Tensor, Tensor> mask_merges(const Tensor& edge_index, const Tensor& cost, const Tensor& count,
                                       const Tensor& size, const Tensor& in_mask, const Tensor& in_frame,
                                       const Tensor& weight, const Tensor& frame_of_mask, double apart_weight,
                                       double prior_weight, double threshold, const Tensor& stays, int64_t min_size) {
  const Tensor edges = checked_edge_index(edge_index);
  const int64_t num_edges = edges.size(1);
  const Tensor costs = checked_array(cost, ScalarType::Float, {num_edges}, "cost");
  const Tensor sizes = checked_array(size, ScalarType::Long, {-1}, "size");
  const int64_t num_regions = sizes.size(0);
  const Tensor weights = checked_array(weight, ScalarType::Long, {-1}, "weight");
  const int64_t num_masks = weights.size(0);
  const Tensor frames_of = checked_array(frame_of_mask, ScalarType::Long, {num_masks}, "frame_of_mask");
  const Tensor of_masks = checked_array(in_mask, ScalarType::Long, {3, -1}, "in_mask");
  const Tensor of_frames = checked_array(in_frame, ScalarType::Long, {3, -1}, "in_frame");
  check(num_regions <= kMaxCount, "size: expected at most 2^31 - 1 regions, got ", num_regions);
  check(apart_weight >= 0 && std::isfinite(apart_weight), "apart_weight: expected a finite number >= 0, got ",
        apart_weight);
  check(prior_weight > 0 && std::isfinite(prior_weight), "prior_weight: expected a finite number > 0, got ",
        prior_weight);
  check(threshold >= 0, "threshold: expected a number >= 0, got ", threshold);
  const Tensor staying = checked_array(stays, ScalarType::Bool, {num_regions}, "stays");
  check(min_size >= 0, "min_size: expected a number >= 0, got ", min_size);
  const int64_t* const num_points = sizes.const_data_ptr<int64_t>();
  const int64_t* const of_mask = weights.const_data_ptr<int64_t>();
  for (int64_t region = 0; region < num_regions; ++region) {
    check(num_points[region] > 0, "size: expected numbers > 0, got ", num_points[region], " at ", region);
  }
  for (int64_t mask = 0; mask < num_masks; ++mask) {
    check(of_mask[mask] >= 0 && of_mask[mask] <= kWeightUnit, "weight: expected numbers in [0, ", kWeightUnit,
          "], got ", of_mask[mask], " at ", mask);
  }

  MaskGraph graph(read_views(of_masks, of_frames, frames_of, of_mask, num_masks, num_regions), num_points, of_mask,
                  apart_weight, prior_weight, staying.const_data_ptr<bool>(), min_size);
  const int64_t* const ends = edges.const_data_ptr<int64_t>();
  const float* const priors = costs.const_data_ptr<float>();
  const Tensor counts = checked_counts(count, num_edges);
  for (int64_t e = 0; e < num_edges; ++e) {
    const int64_t a = ends[e], b = ends[num_edges + e];
    check_ends(a, b, num_regions, e);
    check(priors[e] >= 0 && priors[e] <= 1, "cost: expected numbers in [0, 1], got ", priors[e], " at edge ", e);
    if (a == b) continue;
    graph.add_edges(static_cast<int32_t>(a), static_cast<int32_t>(b),
                    static_cast<int64_t>(std::nearbyint(priors[e] * kUnit)), counts.const_data_ptr<int64_t>()[e]);
  }

  Merged merged(num_points, num_regions);
  std::vector<int64_t> lower, higher;
  std::vector<double> cost_of_merge;
  graph.merge_all(threshold, [&](int32_t one, int32_t other, double value) {
    const int32_t a = merged.find(one), b = merged.find(other);
    lower.push_back(std::min(a, b));
    higher.push_back(std::max(a, b));
    cost_of_merge.push_back(value);
    merged.join(a, b);
  });
  return {to_pairs(lower, higher, edges), to_tensor(cost_of_merge, ScalarType::Double, edges)};
}

}  // namespace

TORCHJOINT_OPERATOR(mask_merges,
                    "(Tensor edge_index, Tensor cost, Tensor count, Tensor size, Tensor in_mask, Tensor in_frame, "
                    "Tensor weight, Tensor frame_of_mask, float apart_weight, float prior_weight, float threshold, "
                    "Tensor stays, int min_size) -> (Tensor, Tensor)");

}  // namespace torchjoint
