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
  Array<int32_t> link_;  // the parent, or, at a root, minus the size
};

}  // namespace torchjoint
