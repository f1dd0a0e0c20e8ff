// Union-find: which nodes of a graph are connected.
#pragma once

#include <algorithm>
#include <cstdint>
#include <utility>

#include "array.h"

namespace torchjoint {

class UnionFind {
 public:
  explicit UnionFind(int64_t num_nodes) : link_(num_nodes) { std::fill_n(link_.data(), num_nodes, -1); }

  size_t num_nodes() const { return link_.size(); }
  int32_t size(int32_t root) const { return -link_[root]; }

  int32_t find(int32_t node) {
    while (true) {
      const int32_t parent = link_[node];
      if (parent < 0) return node;
      const int32_t grandparent = link_[parent];
      if (grandparent < 0) return parent;
      node = link_[node] = grandparent;  // path halving
    }
  }

  // Two steps towards the root, with path halving. It has no branches, because they would be unpredictable.
  int32_t climb(int32_t node) {
    const int32_t link = link_[node];
    const int32_t parent = select(link < 0, node, link);
    const int32_t link_of_parent = link_[parent];
    link_[node] = select(link_of_parent < 0, link, link_of_parent);
    return select(link_of_parent < 0, parent, link_of_parent);
  }

  // Joins two different roots; returns the root of both.
  int32_t join(int32_t a, int32_t b) {
    if (size(a) < size(b)) std::swap(a, b);
    link_[a] += link_[b];
    link_[b] = a;
    return a;
  }

  void prefetch(int32_t node) const { __builtin_prefetch(&link_[node], 1); }

  // Labels in the order of first appearance.
  void write_labels(int64_t* labels) {
    int64_t next = 0;
    std::fill_n(labels, num_nodes(), -1);
    for (size_t i = 0; i < num_nodes(); ++i) {
      int64_t& label = labels[find(static_cast<int32_t>(i))];
      if (label < 0) label = next++;
      labels[i] = label;
    }
  }

 private:
  // `condition ? yes : no` without a branch, which compilers tend to generate.
  static int32_t select(bool condition, int32_t yes, int32_t no) {
    const int32_t mask = -static_cast<int32_t>(condition);
    return (yes & mask) | (no & ~mask);
  }

  Array<int32_t> link_;  // the parent, or, at a root, minus the size
};

}  // namespace torchjoint
