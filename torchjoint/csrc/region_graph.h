// A region adjacency graph: regions and the boundaries between them (`RegionBoundary`). Repeatedly merges the two regions with
// the lowest mean boundary cost (average linkage), or another cost of boundaries.
#pragma once

#include "array.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cstdint>
#include <functional>
#include <limits>
#include <utility>
#include <vector>

namespace torchjoint {

constexpr int32_t kNone = -1;

// The boundary between two regions: the number of edges that cross it, and the sum of their costs.
struct RegionBoundary {
  int32_t region[2];
  double sum;
  int64_t count;
  int32_t first_part, last_part;  // list of the original boundaries that were joined into it

  double mean() const { return sum / static_cast<double>(count); }
};

struct MeanCost {
  double operator()(const RegionBoundary& border) const { return border.mean(); }
};

// A map from pairs of regions a < b to numbers; no pair is ever removed. The first pairs of each region a lie beside each
// other: regions that are near in space mostly have near numbers, so look-ups one after the other mostly hit the
// processor's cache. The others are in a hash map with open addressing.
class NumberMap {
 public:
  explicit NumberMap(int64_t num_regions) : near_(kNear * num_regions) {
    std::fill_n(near_.data(), near_.size(), Near{kNone, kNone});
    resize(1 << 10);
  }

  // The number of a pair; a new pair gets `number`.
  int32_t& operator()(int32_t a, int32_t b, int32_t number) {
    if (a > b) std::swap(a, b);
    Near* const own = &near_[kNear * static_cast<size_t>(a)];
    for (int i = 0; i < kNear; ++i) {
      if (own[i].region == kNone) own[i] = {b, number};
      if (own[i].region == b) return own[i].number;
    }
    if (2 * count_ >= slots_.size()) grow();
    const uint64_t key = static_cast<uint64_t>(a) << 32 | static_cast<uint64_t>(b);  // never 0
    Slot& slot = slot_of(key);
    if (slot.key == 0) slot = {key, number}, ++count_;
    return slot.number;
  }

  // Prefetches the memory of a pair before its look-up.
  void prefetch(int32_t a, int32_t b) const { __builtin_prefetch(&near_[kNear * static_cast<size_t>(std::min(a, b))]); }

 private:
  static constexpr int kNear = 16;

  struct Near {
    int32_t region, number;
  };

  struct Slot {
    uint64_t key;
    int32_t number;
  };

  Slot& slot_of(uint64_t key) {
    size_t at = (key ^ key >> 32) * 0x9E3779B97F4A7C15u >> shift_;
    while (slots_[at].key != 0 && slots_[at].key != key) at = (at + 1) & (slots_.size() - 1);
    return slots_[at];
  }

  void resize(size_t size) {
    slots_ = Array<Slot>(size);
    std::fill_n(slots_.data(), size, Slot{0, kNone});
    shift_ = 64 - std::countr_zero(size);
  }

  void grow() {
    const Array<Slot> before = std::move(slots_);
    resize(2 * before.size());
    for (size_t i = 0; i < before.size(); ++i) {
      if (before[i].key != 0) slot_of(before[i].key) = before[i];
    }
  }

  Array<Near> near_;  // kNear pairs of each region
  int shift_ = 0;  // 64 - log2 of the number of slots
  size_t count_ = 0;
  Array<Slot> slots_{0};  // accessed at random: in huge pages if there are many
};

// A priority queue of boundaries; the boundary with the lowest mean, then number, comes first. A new mean is seldom below
// the last one that left the queue. So only a few boundaries must be in order; the others are in buckets by the first
// bits of their means.
class MergeQueue {
 public:
  MergeQueue() : far_(kBuckets) {}

  void push(double mean, int32_t number) {
    const uint32_t bucket =
        std::bit_cast<uint32_t>(static_cast<float>(mean)) >> kShift;  // grows with the mean, which is >= 0
    if (bucket < open_) {
      near_.emplace_back(mean, number);
      std::push_heap(near_.begin(), near_.end(), std::greater<>());
    } else {
      far_[bucket].emplace_back(mean, number);
    }
  }

  bool empty() {
    while (near_.empty() && open_ < kBuckets) {
      near_ = std::move(far_[open_++]);
      std::make_heap(near_.begin(), near_.end(), std::greater<>());
    }
    return near_.empty();
  }

  // The lowest mean and its number; only if the queue is not empty.
  std::pair<double, int32_t> pop() {
    std::pop_heap(near_.begin(), near_.end(), std::greater<>());
    const std::pair<double, int32_t> lowest = near_.back();
    near_.pop_back();
    return lowest;
  }

 private:
  static constexpr int kShift = 18;  // 32 buckets for each power of two
  static constexpr uint32_t kBuckets = 1u << (31 - kShift);

  using Waiting = std::vector<std::pair<double, int32_t>>;

  std::vector<Waiting> far_;  // the buckets, unsorted
  Waiting near_;  // a heap of the boundaries in buckets below open_
  uint32_t open_ = 0;
};

// Of boundaries with equal means, the one with the lowest number is merged first. Boundaries are numbered in the order
// in which they are added; a joined boundary keeps the lower number. Costs must be whole numbers with sums below 2^53:
// then sums are exact and do not depend on the order.
class RegionAdjacencyGraph {
 public:
  explicit RegionAdjacencyGraph(int64_t num_regions) : number_of_(num_regions), borders_around_(num_regions) {}

  size_t num_borders() const { return borders_.size(); }
  const RegionBoundary& border(int32_t number) const { return borders_[number]; }

  // Adds `count` edges of a cost to the boundary between two regions a != b; returns the boundary's number. Call it only
  // before merging.
  int32_t add(int32_t a, int32_t b, double cost, int64_t count = 1) {
    const int32_t number = number_of_(a, b, static_cast<int32_t>(borders_.size()));
    if (number == static_cast<int32_t>(borders_.size())) {
      borders_.push_back({{a, b}, 0, 0, number, number});
    }
    borders_[number].sum += cost * static_cast<double>(count);
    borders_[number].count += count;
    return number;
  }

  // Repeatedly merges the two regions of the weakest boundary with `may_merge(border)`, until there is none. `may_merge`
  // of a boundary may change from false to true, and its cost may fall, only when the boundary is joined with another
  // one. `on_merge(number)` is called before each merge; if it returns false, the two regions do not merge. Afterwards
  // `region` of a boundary holds the merged regions on its two sides.
  template <typename MayMerge, typename OnMerge, typename Cost = MeanCost>
  void merge_weakest(const MayMerge& may_merge, const OnMerge& on_merge, const Cost& cost = {}) {
    if (is_gone_.empty()) list_borders();
    MergeQueue waiting;
    constexpr double kNever = std::numeric_limits<double>::infinity();
    Array<double> turn(borders_.size());  // the cost with which each boundary is in the queue
    const auto wait = [&](int32_t number) {
      turn[number] = cost(borders_[number]);
      waiting.push(turn[number], number);
    };
    for (size_t number = 0; number < borders_.size(); ++number) {
      turn[number] = kNever;
      if (!is_gone_[number] && may_merge(borders_[number])) wait(static_cast<int32_t>(number));
    }
    // A boundary whose cost rose is updated when it leaves the queue: most costs change again before.
    const auto on_join = [&](int32_t number) {
      if (cost(borders_[number]) < turn[number] && may_merge(borders_[number])) wait(number);
    };
    while (!waiting.empty()) {
      const auto [least, number] = waiting.pop();
      if (is_gone_[number] || least != turn[number]) continue;  // an old entry of the queue
      turn[number] = kNever;
      if (!may_merge(borders_[number])) continue;
      if (least != cost(borders_[number])) {
        wait(number);
        continue;
      }
      if (!on_merge(number)) continue;
      is_gone_[number] = true;
      merge(borders_[number].region[0], borders_[number].region[1], on_join);
    }
  }

  // Calls `function(original boundary)` for each boundary that was joined into boundary `number`.
  template <typename Function>
  void for_each_part(int32_t number, const Function& function) const {
    for (int32_t part = borders_[number].first_part; part != kNone; part = next_part_[part]) function(part);
  }

 private:
  // Lists the boundaries around each region; called once, after all boundaries were added.
  void list_borders() {
    is_gone_.resize(borders_.size(), false);
    next_part_.resize(borders_.size(), kNone);
    std::vector<int32_t> count(borders_around_.size(), 0);
    for (const RegionBoundary& border : borders_) ++count[border.region[0]], ++count[border.region[1]];
    for (size_t region = 0; region < count.size(); ++region) borders_around_[region].reserve(count[region]);
    for (size_t number = 0; number < borders_.size(); ++number) {
      for (const int32_t region : borders_[number].region) {
        borders_around_[region].push_back(static_cast<int32_t>(number));
      }
    }
  }

  // The region with fewer boundaries passes its boundaries to the other region.
  template <typename OnJoin>
  void merge(int32_t kept, int32_t given, const OnJoin& on_join) {
    if (borders_around_[kept].size() < borders_around_[given].size()) std::swap(kept, given);
    const std::vector<int32_t> moving = std::move(borders_around_[given]);
    // The data of successive boundaries are far apart in memory: prefetching makes their waiting times overlap.
    for (const int32_t moved : moving) __builtin_prefetch(&borders_[moved]);
    for (const int32_t moved : moving) {
      const int32_t* const region = borders_[moved].region;
      number_of_.prefetch(kept, region[region[0] == given ? 1 : 0]);
    }
    for (const int32_t moved : moving) {
      if (is_gone_[moved]) continue;
      int32_t* const region = borders_[moved].region;
      region[region[0] == given ? 0 : 1] = kept;
      int32_t& number = number_of_(region[0], region[1], moved);
      if (number != moved) {
        number = join(number, moved);
        on_join(number);
      }
      if (number == moved) borders_around_[kept].push_back(moved);
    }
  }

  int32_t join(int32_t a, int32_t b) {
    if (a > b) std::swap(a, b);
    borders_[a].sum += borders_[b].sum;
    borders_[a].count += borders_[b].count;
    next_part_[borders_[a].last_part] = borders_[b].first_part;
    borders_[a].last_part = borders_[b].last_part;
    is_gone_[b] = true;
    return a;
  }

  std::vector<RegionBoundary> borders_;
  std::vector<uint8_t> is_gone_;
  std::vector<int32_t> next_part_;  // of each original boundary
  NumberMap number_of_;  // number of a boundary by its two regions
  std::vector<std::vector<int32_t>> borders_around_;
};

}  // namespace torchjoint
