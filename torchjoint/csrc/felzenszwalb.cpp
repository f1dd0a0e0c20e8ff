// Graph-based segmentation: P. Felzenszwalb, D. Huttenlocher, "Efficient Graph-Based Image Segmentation", IJCV 2004.
#include "common.h"

#include <algorithm>
#include <array>
#include <bit>
#include <memory>
#include <utility>
#include <vector>

namespace torchjoint {
namespace {

struct Edge {
  int32_t u, v;
};

struct Keyed {
  uint32_t key;   // orders as the weight does
  uint32_t edge;  // position in the input
};

constexpr int kDigitBits = 11;
constexpr int kPasses = 3;  // 3 * 11 bits >= 32
constexpr uint32_t kDigits = 1u << kDigitBits;

using Histograms = std::array<std::array<uint32_t, kDigits>, kPasses>;

uint32_t digit(uint32_t key, int pass) { return (key >> (pass * kDigitBits)) & (kDigits - 1); }

// Maps floats to integers in the same order: negatives are flipped, positives go above them. +0 makes -0.0 equal 0.0.
uint32_t sort_key(float weight) {
  const uint32_t bits = std::bit_cast<uint32_t>(weight + 0.0f);
  return (bits & 0x80000000u) ? ~bits : bits | 0x80000000u;
}

float weight_of(uint32_t key) {
  return std::bit_cast<float>((key & 0x80000000u) ? key & 0x7fffffffu : ~key);
}

// A plain array that is not zeroed: every element is written before it is read.
template <typename T>
struct Array {
  explicit Array(size_t length) : size(length), data(std::make_unique_for_overwrite<T[]>(length)) {}
  T& operator[](size_t i) { return data[i]; }
  const T& operator[](size_t i) const { return data[i]; }

  size_t size;
  std::unique_ptr<T[]> data;
};

struct Input {
  explicit Input(size_t num_edges) : edges(num_edges), order(num_edges) {}

  Array<Edge> edges;
  Array<Keyed> order;
  Histograms histograms{};
};

// One pass over the input: checks it, narrows it to 32 bits, and counts the digits of the sort.
template <typename Weight>
Input read_input(const int64_t* edge_index, const Weight* weight, int64_t num_edges, int64_t num_nodes) {
  Input input(num_edges);
  for (int64_t e = 0; e < num_edges; ++e) {
    const int64_t u = edge_index[e], v = edge_index[num_edges + e];
    check_node(u, num_nodes, e);
    check_node(v, num_nodes, e);
    const float w = static_cast<float>(weight[e]);
    if (w != w) [[unlikely]] fail("weight: expected no NaN, got NaN at edge ", e);
    const uint32_t key = sort_key(w);
    input.edges[e] = {static_cast<int32_t>(u), static_cast<int32_t>(v)};
    input.order[e] = {key, static_cast<uint32_t>(e)};
    for (int pass = 0; pass < kPasses; ++pass) ++input.histograms[pass][digit(key, pass)];
  }
  return input;
}

// Least significant digit first; every pass is stable, so ties stay in the order of the edges.
void radix_sort(Array<Keyed>& order, Histograms& histograms) {
  if (order.size == 0) return;
  Array<Keyed> buffer(order.size);
  for (int pass = 0; pass < kPasses; ++pass) {
    auto& starts = histograms[pass];
    if (starts[digit(order[0].key, pass)] == order.size) continue;  // all alike in this digit
    uint32_t start = 0;
    for (uint32_t& count : starts) start += std::exchange(count, start);
    for (size_t i = 0; i < order.size; ++i) buffer[starts[digit(order[i].key, pass)]++] = order[i];
    std::swap(order, buffer);
  }
}

// Union-find whose roots carry what the predicate needs, in one piece of memory.
class Forest {
 public:
  Forest(int64_t num_nodes, float scale) : nodes_(num_nodes) {
    for (int64_t i = 0; i < num_nodes; ++i) nodes_[i] = {static_cast<int32_t>(i), 1, scale};
  }

  int32_t find(int32_t node) {
    while (nodes_[node].parent != node) {
      node = nodes_[node].parent = nodes_[nodes_[node].parent].parent;  // path halving
    }
    return node;
  }

  int32_t join(int32_t a, int32_t b) {
    if (nodes_[a].size < nodes_[b].size) std::swap(a, b);
    nodes_[b].parent = a;
    nodes_[a].size += nodes_[b].size;
    return a;
  }

  int32_t size(int32_t root) const { return nodes_[root].size; }
  float threshold(int32_t root) const { return nodes_[root].threshold; }
  void set_threshold(int32_t root, float threshold) { nodes_[root].threshold = threshold; }
  void prefetch(int32_t node) const { __builtin_prefetch(&nodes_[node], 1); }

  // Labels in the order of first appearance. Destroys the sizes: a root's size becomes ~label.
  void write_labels(int64_t* labels) {
    int32_t next = 0;
    for (size_t i = 0; i < nodes_.size; ++i) {
      Node& root = nodes_[find(static_cast<int32_t>(i))];
      if (root.size >= 0) root.size = ~next++;
      labels[i] = ~root.size;
    }
  }

 private:
  struct Node {
    int32_t parent;
    int32_t size;
    float threshold;  // Int(C) + k/|C|
  };
  static_assert(sizeof(Node) == 12);

  Array<Node> nodes_;
};

// How many edges ahead to fetch an edge, and then the nodes at its ends: the loop is bound by cache misses.
constexpr size_t kEdgeAhead = 32;
constexpr size_t kNodeAhead = 16;

// The paper's algorithm 1. Returns the edges that were refused, in order, as pairs of then-roots.
std::vector<Edge> merge_by_predicate(Forest& forest, const Input& input, float scale, bool keep_refused) {
  std::vector<Edge> refused;
  const auto& order = input.order;
  const size_t num_edges = order.size;
  for (size_t i = 0; i < num_edges; ++i) {
    if (i + kEdgeAhead < num_edges) __builtin_prefetch(&input.edges[order[i + kEdgeAhead].edge]);
    if (i + kNodeAhead < num_edges) {
      const Edge ahead = input.edges[order[i + kNodeAhead].edge];
      forest.prefetch(ahead.u);
      forest.prefetch(ahead.v);
    }
    const Edge edge = input.edges[order[i].edge];
    const int32_t a = forest.find(edge.u), b = forest.find(edge.v);
    if (a == b) continue;
    const float weight = weight_of(order[i].key);
    if (weight <= forest.threshold(a) && weight <= forest.threshold(b)) {
      const int32_t root = forest.join(a, b);
      // Edges come in ascending order: this one is the largest of the component's spanning tree.
      forest.set_threshold(root, weight + scale / static_cast<float>(forest.size(root)));
    } else if (keep_refused) {
      refused.push_back({a, b});
    }
  }
  return refused;
}

void join_small(Forest& forest, const std::vector<Edge>& refused, int64_t min_size) {
  for (const Edge& edge : refused) {
    const int32_t a = forest.find(edge.u), b = forest.find(edge.v);
    if (a != b && (forest.size(a) < min_size || forest.size(b) < min_size)) forest.join(a, b);
  }
}

Tensor felzenszwalb(
    const Tensor& edge_index, const Tensor& weight, int64_t num_nodes, double scale, int64_t min_size) {
  const Tensor edges = checked_edge_index(edge_index);
  const int64_t num_edges = edges.size(1);
  const Tensor weights = checked_values(weight, num_edges, "weight");
  check(num_nodes >= 0 && num_nodes <= kMaxCount, "num_nodes: expected 0 <= num_nodes < 2^31, got ", num_nodes);
  check(scale >= 0, "scale: expected a number >= 0, got ", scale);
  check(min_size >= 0, "min_size: expected a number >= 0, got ", min_size);

  const int64_t* index = edges.const_data_ptr<int64_t>();
  Input input =
      with_values(weights, [&](const auto* values) { return read_input(index, values, num_edges, num_nodes); });
  radix_sort(input.order, input.histograms);

  const float k = static_cast<float>(scale);
  Forest forest(num_nodes, k);
  join_small(forest, merge_by_predicate(forest, input, k, min_size > 1), min_size);

  Tensor labels = torch::stable::new_empty(edges, {num_nodes}, ScalarType::Long);
  forest.write_labels(labels.mutable_data_ptr<int64_t>());
  return labels;
}

}  // namespace

STABLE_TORCH_LIBRARY_FRAGMENT(torchjoint, m) {
  m.def(
      "felzenszwalb(Tensor edge_index, Tensor weight, SymInt num_nodes, float scale, SymInt min_size=0) -> Tensor");
}

STABLE_TORCH_LIBRARY_IMPL(torchjoint, CPU, m) {
  m.impl("felzenszwalb", TORCH_BOX(&felzenszwalb));
}

}  // namespace torchjoint
