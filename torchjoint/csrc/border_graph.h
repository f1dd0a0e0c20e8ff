// Regions and the borders between them, which are merged one by one, the weakest border first.
#pragma once

#include <algorithm>
#include <cstdint>
#include <functional>
#include <queue>
#include <utility>
#include <vector>

namespace torchjoint {

constexpr int32_t kNone = -1;

// What parts two regions: how many edges cross it, and the sum of their costs.
struct Border {
  int32_t region[2];
  double sum;
  int64_t count;
  int32_t first_part, last_part;  // of the list of original borders it is made of

  double mean() const { return sum / static_cast<double>(count); }
};

// Numbers by key; a key is never 0, and none is ever taken out. Open addressing: what is looked up next is mostly nowhere
// near what was looked up last, so that each miss of the cache counts.
class NumberOf {
 public:
  // The number of a key, which is `number` if there was none before.
  int32_t& operator()(uint64_t key, int32_t number) {
    if (2 * count_ >= slots_.size()) grow();
    Slot& slot = slot_of(key);
    if (slot.key == 0) slot = {key, number}, ++count_;
    return slot.number;
  }

 private:
  struct Slot {
    uint64_t key = 0;
    int32_t number = kNone;
  };

  Slot& slot_of(uint64_t key) {
    const size_t mask = slots_.size() - 1;
    size_t at = (key ^ key >> 32) * 0x9E3779B97F4A7C15u >> shift_;
    while (slots_[at].key != 0 && slots_[at].key != key) at = (at + 1) & mask;
    return slots_[at];
  }

  void grow() {
    const std::vector<Slot> before(std::exchange(slots_, std::vector<Slot>(2 * slots_.size())));
    --shift_;
    for (const Slot& slot : before) {
      if (slot.key != 0) slot_of(slot.key) = slot;
    }
  }

  int shift_ = 54;  // 64 - log2 of the number of slots
  size_t count_ = 0;
  std::vector<Slot> slots_ = std::vector<Slot>(1 << 10);
};

// Of equally weak borders the one with the lowest number comes first; borders are numbered as they come, and keep the
// lower number when they join. Sums are exact, so that they do not depend on the order, as long as they are whole numbers below 2^53.
class BorderGraph {
 public:
  explicit BorderGraph(int64_t num_regions) : borders_around_(num_regions) {}

  size_t num_borders() const { return borders_.size(); }
  const Border& border(int32_t number) const { return borders_[number]; }

  // Adds an edge to the border between a and b, which are two regions; returns its number. Not once any were merged.
  int32_t add(int32_t a, int32_t b, double cost) {
    const int32_t number = number_of_(key(a, b), static_cast<int32_t>(borders_.size()));
    if (number == static_cast<int32_t>(borders_.size())) {
      borders_.push_back({{a, b}, 0, 0, number, number});
    }
    borders_[number].sum += cost;
    ++borders_[number].count;
    return number;
  }

  // Merges the two regions of the weakest border that may go, again and again, until none may. Whether `may_go(border)`
  // must not become true for a border unless it is joined with another; `on_merge(number)` is called before each merge.
  // Afterwards a border's `region` are the two that are left of what it once parted.
  template <typename MayGo, typename OnMerge>
  void merge_weakest(const MayGo& may_go, const OnMerge& on_merge) {
    if (is_gone_.empty()) list_borders();
    std::vector<Waiting> may;
    for (size_t number = 0; number < borders_.size(); ++number) {
      if (!is_gone_[number] && may_go(borders_[number])) {
        may.emplace_back(borders_[number].mean(), static_cast<int32_t>(number));
      }
    }
    Queue waiting(std::greater<>(), std::move(may));
    const auto on_join = [&](int32_t number) {
      if (may_go(borders_[number])) waiting.emplace(borders_[number].mean(), number);
    };
    while (!waiting.empty()) {
      const auto [mean, number] = waiting.top();
      waiting.pop();
      if (is_gone_[number] || mean != borders_[number].mean() || !may_go(borders_[number])) continue;
      on_merge(number);
      is_gone_[number] = true;
      merge(borders_[number].region[0], borders_[number].region[1], on_join);
    }
  }

  // Calls `function(original border)` for all that a border was joined from.
  template <typename Function>
  void for_each_part(int32_t number, const Function& function) const {
    for (int32_t part = borders_[number].first_part; part != kNone; part = next_part_[part]) function(part);
  }

 private:
  using Waiting = std::pair<double, int32_t>;  // mean and number; stale where the mean is another by now
  using Queue = std::priority_queue<Waiting, std::vector<Waiting>, std::greater<>>;

  static uint64_t key(int32_t a, int32_t b) {
    return static_cast<uint64_t>(std::min(a, b)) << 32 | static_cast<uint64_t>(std::max(a, b));
  }

  // Once all borders are there: those around each region.
  void list_borders() {
    is_gone_.resize(borders_.size(), false);
    next_part_.resize(borders_.size(), kNone);
    std::vector<int32_t> count(borders_around_.size(), 0);
    for (const Border& border : borders_) ++count[border.region[0]], ++count[border.region[1]];
    for (size_t region = 0; region < count.size(); ++region) borders_around_[region].reserve(count[region]);
    for (size_t number = 0; number < borders_.size(); ++number) {
      for (const int32_t region : borders_[number].region) {
        borders_around_[region].push_back(static_cast<int32_t>(number));
      }
    }
  }

  // The region with fewer borders gives them to the other one.
  template <typename OnJoin>
  void merge(int32_t kept, int32_t given, const OnJoin& on_join) {
    if (borders_around_[kept].size() < borders_around_[given].size()) std::swap(kept, given);
    const std::vector<int32_t> moving = std::move(borders_around_[given]);
    for (const int32_t moved : moving) {
      if (is_gone_[moved]) continue;
      int32_t* const region = borders_[moved].region;
      region[region[0] == given ? 0 : 1] = kept;
      int32_t& number = number_of_(key(region[0], region[1]), moved);
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

  std::vector<Border> borders_;
  std::vector<uint8_t> is_gone_;
  std::vector<int32_t> next_part_;  // of each original border
  NumberOf number_of_;  // a border by its two regions
  std::vector<std::vector<int32_t>> borders_around_;
};

}  // namespace torchjoint
