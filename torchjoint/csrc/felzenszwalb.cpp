// The operator felzenszwalb: P. Felzenszwalb, D. Huttenlocher, "Efficient Graph-Based Image Segmentation", IJCV 2004.
#include "ascending.h"
#include "common.h"
#include "union_find.h"

namespace torchjoint {
namespace {

// Algorithm 1 of the paper: a Graph for Ascending. Each root also stores the value that the merging predicate needs.
class Components : public UnionFind {
 public:
  Components(int64_t num_nodes, float scale, int64_t min_size)
      : UnionFind(num_nodes), threshold_(num_nodes), scale_(scale),
        min_size_(static_cast<int32_t>(std::min(min_size, num_nodes))) {
    std::fill_n(threshold_.data(), num_nodes, scale);
  }

  bool filter(Ends& ends) {
    ends = {find(ends.u), find(ends.v)};
    return ends.u != ends.v;
  }

  void visit(Ends ends, float weight) {
    const int32_t a = find(ends.u), b = find(ends.v);
    if (a == b) return;
    if (weight <= threshold_[a] && weight <= threshold_[b]) {
      // Edges come in ascending order, so this edge is the heaviest in the spanning tree of the joined component.
      const int32_t root = join(a, b);
      threshold_[root] = weight + scale_ / static_cast<float>(size(root));
    } else if (is_small(a) || is_small(b)) {
      refused_.push_back({a, b});
    }
  }

  // The second pass: joins each small component along its first edge to another component.
  void join_small() {
    for (const Ends& ends : refused_) {
      const int32_t a = find(ends.u), b = find(ends.v);
      if (a != b && (is_small(a) || is_small(b))) join(a, b);
    }
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
  bool is_small(int32_t root) const { return size(root) < min_size_; }

  // A separate array, because links are read far more often than thresholds.
  Array<float> threshold_;  // of a root: Int(C) + k / |C|
  float scale_;
  int32_t min_size_;
  std::vector<Ends> refused_;  // edges that the second pass may need, in order
};

Tensor felzenszwalb(const Tensor& edge_index, const Tensor& weight, int64_t num_nodes, double scale, int64_t min_size) {
  const Tensor edges = checked_edge_index(edge_index);
  const int64_t num_edges = edges.size(1);
  const Tensor weights = checked_values(weight, num_edges, "weight");
  check(num_nodes >= 0 && num_nodes <= kMaxCount, "num_nodes: expected 0 <= num_nodes < 2^31, got ", num_nodes);
  check(scale >= 0, "scale: expected a number >= 0, got ", scale);
  check(min_size >= 0, "min_size: expected a number >= 0, got ", min_size);

  Tensor labels = torch::stable::new_empty(edges, {num_nodes}, ScalarType::Long);
  with_values(weights, [&](const auto* values) {
    const int64_t* const ends = edges.const_data_ptr<int64_t>();
    for (int64_t e = 0; e < num_edges; ++e) {
      check_ends(ends[e], ends[num_edges + e], num_nodes, e);
      check(values[e] == values[e], "weight: expected no NaN, got NaN at edge ", e);
    }
    Components components(num_nodes, static_cast<float>(scale), min_size);
    Ascending(ends, values, num_edges, components).visit_all();
    components.join_small();
    components.write_labels(labels.mutable_data_ptr<int64_t>());
  });
  return labels;
}

}  // namespace

TORCHJOINT_OPERATOR(felzenszwalb,
                    "(Tensor edge_index, Tensor weight, SymInt num_nodes, float scale, SymInt min_size=0) -> Tensor");

}  // namespace torchjoint
