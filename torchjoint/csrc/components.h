// Graph-based segmentation: P. Felzenszwalb, D. Huttenlocher, "Efficient Graph-Based Image Segmentation", IJCV 2004.
// This file has its components, its two passes over the edges, and the algorithm for any source of edges.
#pragma once

#include <algorithm>
#include <cstdint>
#include <utility>
#include <vector>

#include "array.h"
#include "ascending.h"
#include "union_find.h"

namespace torchjoint {

// Union-find; each root also stores the values that the merging predicate needs.
class Components : public UnionFind {
 public:
  Components(int64_t num_nodes, float scale, int64_t min_size)
      : UnionFind(num_nodes), threshold_(num_nodes), scale_(scale),
        min_size_(static_cast<int32_t>(std::min(min_size, num_nodes))) {
    std::fill_n(threshold_.data(), num_nodes, scale);
  }

  bool is_small(int32_t root) const { return size(root) < min_size_; }
  float threshold(int32_t root) const { return threshold_[root]; }

  // Joins two components by an edge. Edges come in ascending order, so this edge is the heaviest in the spanning tree
  // of the joined component.
  void join_by(float weight, int32_t a, int32_t b) {
    const int32_t root = join(a, b);
    threshold_[root] = weight + scale_ / static_cast<float>(size(root));
  }

  void prefetch(Ends ends) const {
    UnionFind::prefetch(ends.u);
    UnionFind::prefetch(ends.v);
  }

  void prefetch_root(Ends ends) const {
    prefetch(ends);
    __builtin_prefetch(&threshold_[ends.u], 1);
    __builtin_prefetch(&threshold_[ends.v], 1);
  }

 private:
  // A separate array, because links are read far more often than thresholds.
  Array<float> threshold_;  // of a root: Int(C) + k / |C|
  float scale_;
  int32_t min_size_;
};

// Algorithm 1 of the paper. This class and JoinSmall are a Graph for Ascending.
class MergeByPredicate {
 public:
  MergeByPredicate(Components& components, size_t memory) : components_(components), memory_(memory) {}

  bool filter(Ends& ends) {
    ends = {components_.climb(ends.u), components_.climb(ends.v)};
    return ends.u != ends.v;
  }

  void visit(Ends ends, float weight) {
    const int32_t a = components_.find(ends.u), b = components_.find(ends.v);
    if (a == b) return;
    if (weight <= components_.threshold(a) && weight <= components_.threshold(b)) {
      components_.join_by(weight, a, b);
    } else if (components_.is_small(a) || components_.is_small(b)) {
      refuse({a, b});
    }
  }

  void prefetch(Ends ends) const { components_.prefetch(ends); }
  void prefetch_root(Ends ends) const { components_.prefetch_root(ends); }

  // Rejected edges that the second pass may need, in order, unless there were too many to store.
  const std::vector<Ends>& refused() const { return refused_; }
  bool remembers_all() const { return remembers_all_; }

 private:
  void refuse(Ends ends) {
    if (refused_.size() < memory_) {
      refused_.push_back(ends);
    } else {
      remembers_all_ = false;
    }
  }

  Components& components_;
  size_t memory_;
  std::vector<Ends> refused_;
  bool remembers_all_ = true;
};

// The second pass: joins each small component along its first edge to another component.
class JoinSmall {
 public:
  explicit JoinSmall(Components& components) : components_(components) {}

  bool filter(Ends& ends) {
    ends = {components_.find(ends.u), components_.find(ends.v)};
    return ends.u != ends.v && (components_.is_small(ends.u) || components_.is_small(ends.v));
  }

  void visit(Ends ends, float = 0) {
    if (filter(ends)) components_.join(ends.u, ends.v);
  }

  void prefetch(Ends ends) const { components_.prefetch(ends); }
  void prefetch_root(Ends ends) const { components_.prefetch(ends); }

 private:
  Components& components_;
};

// At most about `capacity` edges and `memory` rejected edges are held in memory at a time.
template <typename Source>
void segment(const Source& source, Components& components, size_t capacity, size_t memory) {
  MergeByPredicate merge(components, memory);
  visit_ascending(source, merge, capacity);
  JoinSmall join(components);
  if (merge.remembers_all()) {
    for (const Ends& ends : merge.refused()) join.visit(ends);
  } else {
    visit_ascending(source, join, capacity);
  }
}

}  // namespace torchjoint
