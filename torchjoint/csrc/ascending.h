// Visits the edges of a graph in ascending order of weight, ties in the order of the edges, but does not sort all edges.
//
// An algorithm like Kruskal's does not need most edges: their two ends are already joined when the edge is visited
// (V. Osipov, P. Sanders, J. Singler, "The Filter-Kruskal Minimum Spanning Tree Algorithm", ALENEX 2009). So the edges
// are first distributed to groups of ascending weight, unsorted. Inside a group they keep their original order,
// so neighbours in memory are mostly neighbours in the graph. Before a group is visited, edges with joined ends are
// removed, and only the remaining edges are sorted and visited, all within the processor's cache.
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

struct Ends {
  int32_t u, v;
};

struct Edge {
  uint32_t key;
  Ends ends;
};

// A stable radix sort (least significant digit first) of the bits in which the keys of a group differ.
class EdgeSorter {
 public:
  // Returns the sorted edges: `edges` itself, or a buffer that is valid until the next call.
  const Edge* sort(Edge* edges, size_t count, uint32_t lowest, uint32_t highest) {
    if (count < kFew) {
      std::stable_sort(edges, edges + count, [](const Edge& a, const Edge& b) { return a.key < b.key; });
      return edges;
    }
    if (buffer_.size() < count) buffer_.resize(count);
    Edge* from = edges;
    Edge* to = buffer_.data();
    for (int shift = 0; shift < static_cast<int>(std::bit_width(highest - lowest)); shift += kDigitBits) {
      if (distribute(from, to, count, lowest, shift)) std::swap(from, to);
    }
    return from;
  }

 private:
  static constexpr size_t kFew = 32;
  static constexpr int kDigitBits = 11;
  static constexpr uint32_t kDigits = 1u << kDigitBits;

  // Returns false if all edges have the same digit; then no edge was moved.
  bool distribute(const Edge* from, Edge* to, size_t count, uint32_t lowest, int shift) {
    const auto digit = [=](const Edge& edge) { return ((edge.key - lowest) >> shift) & (kDigits - 1); };
    starts_.fill(0);
    for (size_t i = 0; i < count; ++i) ++starts_[digit(from[i])];
    if (starts_[digit(from[0])] == count) return false;
    uint32_t start = 0;
    for (uint32_t& entry : starts_) start += std::exchange(entry, start);
    for (size_t i = 0; i < count; ++i) to[starts_[digit(from[i])]++] = from[i];
    return true;
  }

  std::array<uint32_t, kDigits> starts_;
  std::vector<Edge> buffer_;
};

// Graph: visit(ends, weight) visits an edge; filter(ends) returns false if the edge is no longer needed, and may
//   replace its ends by their current representatives; prefetch(ends) and prefetch_root(ends) are called before both.
template <typename Weight, typename Graph>
class Ascending {
 public:
  // edge_index: [2, num_edges], row by row.
  Ascending(const int64_t* edge_index, const Weight* weight, int64_t num_edges, Graph& graph)
      : graph_(graph), waiting_(num_edges) {
    distribute(edge_index, weight, num_edges, make_groups(weight, num_edges));
  }

  void visit_all() {
    for (const Group& group : groups_) visit_group(group);
  }

 private:
  static constexpr size_t kGroupSize = 1 << 15;  // edges; with the sorter's buffer they fit in a second-level cache
  static constexpr size_t kAhead = 12;  // edges to look ahead: the loops are bound by cache misses
  static constexpr int kShift = 19;  // keys are binned by the bits above
  static constexpr uint32_t kBins = 1u << (32 - kShift);

  struct Group {
    uint32_t lowest, highest;  // keys
    size_t begin, end;  // in waiting_
  };

  static uint32_t key_of(Weight weight) { return sort_key(static_cast<float>(weight)); }

  // Joins bins to groups of at most kGroupSize edges, where one bin has no more; returns the group of each bin.
  std::vector<uint16_t> make_groups(const Weight* weight, int64_t num_edges) {
    std::vector<size_t> counts(kBins);
    for (int64_t e = 0; e < num_edges; ++e) ++counts[key_of(weight[e]) >> kShift];
    std::vector<uint16_t> group_of_bin(kBins);
    for (uint32_t bin = 0; bin < kBins; ++bin) {
      const size_t start = groups_.empty() ? 0 : groups_.back().end;
      if (counts[bin] == 0) continue;
      if (groups_.empty() || start - groups_.back().begin + counts[bin] > kGroupSize) {
        groups_.push_back({bin << kShift, 0, start, start});
      }
      groups_.back().highest = (bin << kShift) + ((1u << kShift) - 1);
      groups_.back().end += counts[bin];
      group_of_bin[bin] = static_cast<uint16_t>(groups_.size() - 1);
    }
    return group_of_bin;
  }

  void distribute(const int64_t* edge_index, const Weight* weight, int64_t num_edges,
                  const std::vector<uint16_t>& group_of_bin) {
    // The ends side by side take few cache lines.
    std::vector<size_t> ends(groups_.size());
    for (size_t g = 0; g < ends.size(); ++g) ends[g] = groups_[g].begin;
    for (int64_t e = 0; e < num_edges; ++e) {
      const uint32_t key = key_of(weight[e]);
      const Ends nodes{static_cast<int32_t>(edge_index[e]), static_cast<int32_t>(edge_index[num_edges + e])};
      waiting_[ends[group_of_bin[key >> kShift]]++] = {key, nodes};
    }
  }

  void visit_group(const Group& group) {
    Edge* const edges = waiting_.data() + group.begin;
    const size_t num_waiting = group.end - group.begin;
    size_t count = 0;
    for (size_t i = 0; i < num_waiting; ++i) {
      if (i + kAhead < num_waiting) graph_.prefetch(edges[i + kAhead].ends);
      Ends ends = edges[i].ends;
      const bool keep = graph_.filter(ends);
      edges[count] = {edges[i].key, ends};
      count += keep;  // no branch, because it would be unpredictable
    }
    const Edge* sorted = sorter_.sort(edges, count, group.lowest, group.highest);
    for (size_t i = 0; i < count; ++i) {
      if (i + kAhead < count) graph_.prefetch_root(sorted[i + kAhead].ends);
      graph_.visit(sorted[i].ends, weight_of(sorted[i].key));
    }
  }

  Graph& graph_;
  std::vector<Group> groups_;
  Array<Edge> waiting_;
  EdgeSorter sorter_;
};

}  // namespace torchjoint
