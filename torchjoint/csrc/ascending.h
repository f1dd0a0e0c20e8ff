// Visits the edges of a graph in ascending order of weight, ties in the order of the edges, but does not sort all edges.
//
// An algorithm like Kruskal's does not need most edges: their two ends are already joined when the edge is visited
// (V. Osipov, P. Sanders, J. Singler, "The Filter-Kruskal Minimum Spanning Tree Algorithm", ALENEX 2009). So the edges
// are first distributed to groups of ascending weight, unsorted. Inside a group they keep their original order,
// so neighbours in memory are mostly neighbours in the graph. Before a group is visited, edges with joined ends are
// removed, and only the remaining edges are sorted and visited, all within the processor's cache.
//
// Memory is bounded: the groups are filled in rounds of at most `capacity` edges. Each round reads all edges again.
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cstdint>
#include <utility>
#include <vector>

#include "array.h"

namespace torchjoint {

// Maps floats to integers of the same order: negative numbers are flipped, positive numbers come after them. Adding +0
// makes -0.0 equal to 0.0.
inline uint32_t sort_key(float weight) {
  const uint32_t bits = std::bit_cast<uint32_t>(weight + 0.0f);
  return bits ^ (static_cast<uint32_t>(static_cast<int32_t>(bits) >> 31) | 0x80000000u);
}

inline float weight_of(uint32_t key) { return std::bit_cast<float>((key & 0x80000000u) ? key & 0x7fffffffu : ~key); }

// Largest number of edges in a block that is read at once.
constexpr size_t kBlock = 1024;

struct Ends {
  int32_t u, v;
};

// The form of an edge while it is sorted. Before that, its group stores it as a Source::Edge.
struct Record {
  uint32_t key;
  Ends ends;
};

// A stable radix sort (least significant digit first) of the bits in which the keys of a group differ.
class RecordSorter {
 public:
  // Returns the sorted records: `records` itself, or a buffer that is valid until the next call.
  const Record* sort(Record* records, size_t count, uint32_t lowest, uint32_t highest) {
    if (count < kFew) {
      insertion_sort(records, count);
      return records;
    }
    if (buffer_.size() < count) buffer_.resize(count);
    Record* from = records;
    Record* to = buffer_.data();
    for (int shift = 0; shift < static_cast<int>(std::bit_width(highest - lowest)); shift += kDigitBits) {
      if (distribute(from, to, count, lowest, shift)) std::swap(from, to);
    }
    return from;
  }

 private:
  static constexpr size_t kFew = 32;
  static constexpr int kDigitBits = 11;
  static constexpr uint32_t kDigits = 1u << kDigitBits;

  static void insertion_sort(Record* records, size_t count) {
    for (size_t i = 1; i < count; ++i) {
      const Record record = records[i];
      size_t place = i;
      for (; place > 0 && records[place - 1].key > record.key; --place) records[place] = records[place - 1];
      records[place] = record;
    }
  }

  // Returns false if all records have the same digit; then no record was moved.
  bool distribute(const Record* from, Record* to, size_t count, uint32_t lowest, int shift) {
    const auto digit = [=](const Record& record) { return ((record.key - lowest) >> shift) & (kDigits - 1); };
    starts_.fill(0);
    for (size_t i = 0; i < count; ++i) ++starts_[digit(from[i])];
    if (starts_[digit(from[0])] == count) return false;
    uint32_t start = 0;
    for (uint32_t& entry : starts_) start += std::exchange(entry, start);
    for (size_t i = 0; i < count; ++i) to[starts_[digit(from[i])]++] = from[i];
    return true;
  }

  std::array<uint32_t, kDigits> starts_;
  std::vector<Record> buffer_;
};

// Source: read(f) calls f(const uint32_t* keys, size_t count, edge) for each block of edges, one after the other;
//   edge(i) is the i-th edge of the block, a small Source::Edge; ends(edge) returns the edge's Ends.
// Graph: visit(ends, weight) visits an edge; filter(ends) returns false if the edge is no longer needed, and may
//   replace its ends by their current representatives; prefetch(ends) and prefetch_root(ends) are called before both.
template <typename Source, typename Graph>
class Ascending {
 public:
  Ascending(const Source& source, Graph& graph, size_t capacity)
      : source_(source), graph_(graph), capacity_(std::max(capacity, kGroupSize)) {}

  void visit_all() { visit_range(0, 0); }

 private:
  static constexpr size_t kGroupSize = 1 << 15;  // edges; with the sorter's buffer they fit in a second-level cache
  static constexpr size_t kAhead = 12;  // edges to look ahead: the loops are bound by cache misses

  // Keys are first binned by their upper 13 bits. Bins with too many keys are divided by the next 13 bits, then by 6.
  static constexpr int kLevels = 3;
  static constexpr std::array<int, kLevels> kShift{19, 6, 0};  // number of bits below the bits of a bin
  static constexpr std::array<uint32_t, kLevels> kBins{1 << 13, 1 << 13, 1 << 6};

  using Edge = typename Source::Edge;

  struct Waiting {
    uint32_t key;
    Edge edge;
  };

  struct Group {
    uint32_t lowest, highest;  // keys
    size_t begin, end;  // in waiting_
  };

  static uint32_t bin_of(uint32_t key, int level) { return (key >> kShift[level]) & (kBins[level] - 1); }

  // Processes the edges of one bin of the level above; the bin starts at the key `first`.
  void visit_range(uint32_t first, int level) {
    const std::vector<size_t> counts = count_bins(first, level);
    size_t in_round = 0;
    const auto finish_round = [&] {
      if (in_round > 0) visit_round(level, in_round);
      in_round = 0;
    };
    std::vector<uint16_t>& group_of_bin = group_of_bin_[level];
    group_of_bin.resize(kBins[level]);
    for (uint32_t bin = 0; bin < kBins[level]; ++bin) {
      const size_t count = counts[bin];
      if (count == 0) continue;
      const uint32_t lowest = first + (bin << kShift[level]);
      const uint32_t highest = lowest + ((1u << kShift[level]) - 1);
      if (in_round + count > capacity_) finish_round();
      if (count > capacity_) {
        if (level + 1 == kLevels) {
          visit_equal(lowest);
        } else {
          visit_range(lowest, level + 1);
        }
        continue;
      }
      if (in_round == 0) groups_.clear();
      if (in_round == 0 || in_round - groups_.back().begin + count > kGroupSize) {
        groups_.push_back({lowest, highest, in_round, in_round});
      }
      groups_.back().highest = highest;
      group_of_bin[bin] = static_cast<uint16_t>(groups_.size() - 1);
      in_round += count;
    }
    finish_round();
  }

  std::vector<size_t> count_bins(uint32_t first, int level) const {
    const uint32_t last = level == 0 ? ~0u : first + ((1u << kShift[level - 1]) - 1);
    std::vector<size_t> counts(kBins[level] + 1);
    source_.read([&](const uint32_t* keys, size_t count, auto) {
      for (size_t i = 0; i < count; ++i) {
        const bool inside = keys[i] - first <= last - first;
        ++counts[inside ? bin_of(keys[i], level) : kBins[level]];
      }
    });
    return counts;
  }

  // Calls f(key, edge) for the edges with keys in [lowest, highest], in their original order.
  template <typename Function>
  void for_each_within(uint32_t lowest, uint32_t highest, Function f) const {
    source_.read([&](const uint32_t* keys, size_t count, auto edge) {
      std::array<uint16_t, kBlock> chosen;
      size_t num_chosen = 0;
      for (size_t i = 0; i < count; ++i) {
        chosen[num_chosen] = static_cast<uint16_t>(i);
        num_chosen += keys[i] - lowest <= highest - lowest;
      }
      for (size_t c = 0; c < num_chosen; ++c) f(keys[chosen[c]], edge(chosen[c]));
    });
  }

  // Edges of equal weight need no sorting: they already have the right order.
  void visit_equal(uint32_t key) {
    const float weight = weight_of(key);
    for_each_within(key, key, [&](uint32_t, Edge edge) { graph_.visit(source_.ends(edge), weight); });
  }

  void visit_round(int level, size_t count) {
    if (waiting_.size() < count) waiting_ = Array<Waiting>(count);
    fill_groups(level);
    for (const Group& group : groups_) visit_group(group);
  }

  void fill_groups(int level) {
    const uint16_t* group_of_bin = group_of_bin_[level].data();
    Waiting* waiting = waiting_.data();
    // The ends side by side take few cache lines.
    std::vector<size_t> ends(groups_.size());
    for (size_t g = 0; g < ends.size(); ++g) ends[g] = groups_[g].begin;
    size_t* end = ends.data();
    for_each_within(groups_.front().lowest, groups_.back().highest,
                    [=](uint32_t key, Edge edge) { waiting[end[group_of_bin[bin_of(key, level)]]++] = {key, edge}; });
    for (size_t g = 0; g < ends.size(); ++g) groups_[g].end = ends[g];
  }

  void visit_group(const Group& group) {
    const Waiting* waiting = waiting_.data() + group.begin;
    const size_t num_waiting = group.end - group.begin;
    if (records_.size() <= num_waiting) records_.resize(num_waiting + 1);
    size_t count = 0;
    for (size_t i = 0; i < num_waiting; ++i) {
      if (i + kAhead < num_waiting) graph_.prefetch(source_.ends(waiting[i + kAhead].edge));
      Ends ends = source_.ends(waiting[i].edge);
      const bool keep = graph_.filter(ends);
      records_[count] = {waiting[i].key, ends};
      count += keep;  // no branch, because it would be unpredictable
    }
    const Record* sorted = sorter_.sort(records_.data(), count, group.lowest, group.highest);
    for (size_t i = 0; i < count; ++i) {
      if (i + kAhead < count) graph_.prefetch_root(sorted[i + kAhead].ends);
      graph_.visit(sorted[i].ends, weight_of(sorted[i].key));
    }
  }

  const Source& source_;
  Graph& graph_;
  size_t capacity_;
  std::array<std::vector<uint16_t>, kLevels> group_of_bin_;
  std::vector<Group> groups_;
  Array<Waiting> waiting_{0};
  std::vector<Record> records_;
  RecordSorter sorter_;
};

template <typename Source, typename Graph>
void visit_ascending(const Source& source, Graph& graph, size_t capacity) {
  Ascending<Source, Graph>(source, graph, capacity).visit_all();
}

}  // namespace torchjoint
