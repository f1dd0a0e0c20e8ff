// The operator felzenszwalb: segments a graph that is given as a list of edges.
#include "common.h"
#include "components.h"

namespace torchjoint {
namespace {

template <typename Weight>
class EdgeList {
 public:
  // Stores the ends, not the edge's number: in the order of weights, looking up ends by number would be random access.
  using Edge = Ends;

  EdgeList(const int64_t* edge_index, const Weight* weight, int64_t num_edges)
      : first_(edge_index), second_(edge_index + num_edges), weight_(weight), num_edges_(num_edges) {}

  template <typename Function>
  void read(Function f) const {
    std::array<uint32_t, kBlock> keys;
    for (int64_t start = 0; start < num_edges_; start += kBlock) {
      const size_t count = std::min<int64_t>(kBlock, num_edges_ - start);
      for (size_t i = 0; i < count; ++i) keys[i] = sort_key(static_cast<float>(weight_[start + i]));
      f(keys.data(), count, [&](size_t i) {
        return Ends{static_cast<int32_t>(first_[start + i]), static_cast<int32_t>(second_[start + i])};
      });
    }
  }

  static Ends ends(Edge edge) { return edge; }

  void check(int64_t num_nodes) const {
    for (int64_t start = 0; start < num_edges_; start += kBlock) {
      const int64_t end = std::min<int64_t>(start + kBlock, num_edges_);
      bool bad = false;
      for (int64_t e = start; e < end; ++e) {
        bad |= static_cast<uint64_t>(first_[e]) >= static_cast<uint64_t>(num_nodes);
        bad |= static_cast<uint64_t>(second_[e]) >= static_cast<uint64_t>(num_nodes);
        bad |= weight_[e] != weight_[e];
      }
      if (bad) [[unlikely]]
        report(start, end, num_nodes);
    }
  }

 private:
  void report(int64_t start, int64_t end, int64_t num_nodes) const {
    for (int64_t e = start; e < end; ++e) {
      check_node(first_[e], num_nodes, e);
      check_node(second_[e], num_nodes, e);
      if (weight_[e] != weight_[e]) fail("weight: expected no NaN, got NaN at edge ", e);
    }
  }

  const int64_t* first_;
  const int64_t* second_;
  const Weight* weight_;
  int64_t num_edges_;
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
    const EdgeList source(edges.const_data_ptr<int64_t>(), values, num_edges);
    source.check(num_nodes);
    Components components(num_nodes, static_cast<float>(scale), min_size);
    segment(source, components, num_edges, num_edges);
    components.write_labels(labels.mutable_data_ptr<int64_t>());
  });
  return labels;
}

}  // namespace

STABLE_TORCH_LIBRARY_FRAGMENT(torchjoint, m) {
  m.def("felzenszwalb(Tensor edge_index, Tensor weight, SymInt num_nodes, float scale, SymInt min_size=0) -> Tensor");
}

STABLE_TORCH_LIBRARY_IMPL(torchjoint, CPU, m) { m.impl("felzenszwalb", TORCH_BOX(&felzenszwalb)); }

}  // namespace torchjoint
