// Minimum s-t cut by preflow-push: A. Goldberg, R. Tarjan, "A New Approach to the Maximum-Flow Problem", J. ACM 1988,
// with highest-label selection, global relabelling and the gap heuristic (B. Cherkassky, A. Goldberg, "On
// Implementing Push-Relabel Method for the Maximum Flow Problem", Algorithmica 1997). Three additions make it fast:
//
// - Parking: if the label of a node has risen by more than `slack_` since the last global relabelling, the node waits
//   for the next one. Otherwise excess without a path would rise step by step, in quadratic time on long thin graphs.
//   Labels stay near the exact distances, as in the incremental breadth-first search of A. Goldberg et al. (ESA 2011).
// - Each global relabelling also pushes all excess along its search tree, as far as the tree's arcs allow, with one push
//   per node. The first one is repeated at once: if all paths to the drains are narrow, they are now full, and nothing is
//   left to do.
// - Seeds become part of their terminals, and leaves are pruned until there are none: trees need no search at all.
//
// Only the first phase is run, which finds the cut but not the flow. A maximum preflow tells which nodes can still
// reach the *sink*, that is the minimal sink side. We want the minimal source side. The edges are undirected, so the
// problem is solved backwards: excess starts at the caller's sinks and is drained at the caller's sources.
#include "common.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <tuple>
#include <utility>
#include <vector>

namespace torchjoint {
namespace {

constexpr int32_t kNone = -1;
constexpr uint32_t kTwinOpen = uint32_t{1} << 31;
constexpr int64_t kDecisive = int64_t{1} << 61;  // more than all edges together, in both directions

struct Arc {
  int64_t residual;
  uint32_t head_and_flag;  // kTwinOpen: the twin has residual capacity; known without reading it
  int32_t twin;  // the same edge, seen from the other end

  int32_t head() const { return static_cast<int32_t>(head_and_flag & ~kTwinOpen); }
  bool twin_open() const { return head_and_flag >= kTwinOpen; }
};

struct Node {
  int64_t balance = 0;  // > 0: excess that has to be drained; < 0: what this node can still drain
  int32_t first_arc = 0;
  int32_t current_arc = 0;  // no arc before this one is admissible
  int32_t exact_label = 0;  // the label after the last global relabelling
  int32_t active_next = 0;
};

// Scales doubles by a power of two to integers: then sums are exact, the order of operations does not matter, and the
// minimal source side is well defined. With E < 2^b edges and capacities < 2^e the scale 2^(60-b-e) keeps the sum
// over both directions of all edges below 2^61.
class Quantiser {
 public:
  Quantiser(double largest, int64_t num_edges) {
    int edge_bits = 0, exponent = 0;
    while (num_edges >> edge_bits) ++edge_bits;
    std::frexp(largest, &exponent);
    scale_ = std::ldexp(1.0, std::min(60 - edge_bits - exponent, 1000));
  }

  // Zero stays zero, a positive value stays positive. `largest` bounds the result.
  int64_t operator()(double value, int64_t largest) const {
    if (value == 0) return 0;
    const double scaled = value * scale_;
    if (scaled >= 0x1p62) return largest;  // not `>= largest`, because a double may not represent it exactly
    // Rounds to the nearest integer, ties to even, like llrint but inline. Above 2^52 all doubles are integers.
    const double rounded = scaled < 0x1p52 ? (scaled + 0x1p52) - 0x1p52 : scaled;
    return std::clamp<int64_t>(static_cast<int64_t>(rounded), 1, largest);
  }

 private:
  double scale_;
};

class Preflow {
 public:
  explicit Preflow(const std::vector<int64_t>& balance)
      : num_nodes_(static_cast<int32_t>(balance.size())), nodes_(balance.size() + 1), label_(balance.size()) {
    for (int32_t i = 0; i < num_nodes_; ++i) {
      nodes_[i].balance = balance[i];
      label_[i] = balance[i] >= kDecisive ? cut_off() : balance[i] <= -kDecisive ? kSettled : 1;
    }
  }

  // All edges are first counted, then added, so the arcs of a node are contiguous, in the order of the edges.
  void count_edge(int64_t u, int64_t v) {
    if (u == v || is_seed(u) || is_seed(v)) return;
    ++nodes_[u].first_arc, ++nodes_[v].first_arc;
  }

  void reserve_arcs() {
    int32_t start = 0;
    for (Node& node : nodes_) {
      node.current_arc = start;  // during construction: the place of the node's next arc
      start += std::exchange(node.first_arc, start);
    }
    arcs_ = std::make_unique_for_overwrite<Arc[]>(start);
  }

  void add_edge(int64_t u, int64_t v, int64_t capacity) {
    if (u == v) return;
    if (is_seed(u) || is_seed(v)) return add_edge_of_seed(u, v, capacity);
    const uint32_t flag = capacity > 0 ? kTwinOpen : 0;
    const int32_t there = nodes_[u].current_arc++, back = nodes_[v].current_arc++;
    arcs_[there] = {capacity, static_cast<uint32_t>(v) | flag, back};
    arcs_[back] = {capacity, static_cast<uint32_t>(u) | flag, there};
  }

  void solve() {
    prune_leaves();
    // This takes about a tenth of the time of a global relabelling.
    const int64_t little_work = num_nodes_ + nodes_[num_nodes_].first_arc / 4;
    level_size_.assign(num_nodes_ + 1, 0);
    active_first_.assign(num_nodes_ + 1, kNone);
    queue_ = std::make_unique_for_overwrite<int32_t[]>(num_nodes_ + 1);
    bool can_flow = relabel_globally() && relabel_globally();
    while (can_flow) {
      do {
        discharge_active();
      } while (work_ < little_work && unpark());
      can_flow = relabel_globally();
    }
    restore_leaves();
  }

  // After solve(): whether the node can still reach a draining node.
  bool can_drain(int64_t node) const { return label_[node] <= num_nodes_; }

 private:
  struct Leaf {
    int32_t node, arc;
  };

  // A label is a lower bound of the distance to a draining node; a draining node has label 1. Special labels:
  static constexpr int32_t kSettled = 0;  // a seed that drains, or a pruned leaf
  int32_t cut_off() const { return num_nodes_ + 1; }  // no way to any draining node

  // While the graph is built, all other nodes have label 1.
  bool is_seed(int64_t node) const { return label_[node] != 1; }

  // An edge to a seed acts like a terminal capacity of its other end.
  void add_edge_of_seed(int64_t u, int64_t v, int64_t capacity) {
    if (is_seed(v)) std::swap(u, v);
    if (!is_seed(v)) nodes_[v].balance += label_[u] == kSettled ? -capacity : capacity;
  }

  // A leaf sends its excess to its neighbour, as far as the edge's capacity allows, or takes as much as it can drain.
  // After that the rest of the graph does not need the leaf.
  void prune_leaves() {
    const auto num_arcs = [&](int32_t i) { return nodes_[i + 1].first_arc - nodes_[i].first_arc; };
    int32_t num_leaves = 0;
    for (int32_t i = 0; i < num_nodes_; ++i) num_leaves += num_arcs(i) == 1;
    if (num_leaves == 0) return;
    std::vector<int32_t> degree(num_nodes_);
    for (int32_t i = 0; i < num_nodes_; ++i) degree[i] = num_arcs(i);
    for (int32_t i = 0; i < num_nodes_; ++i) {
      for (int32_t leaf = i; degree[leaf] == 1;) {
        int32_t a = nodes_[leaf].first_arc;
        while (label_[arcs_[a].head()] == kSettled) ++a;
        Arc& arc = arcs_[a];
        Arc& twin = arcs_[arc.twin];
        const int64_t flow = std::clamp(nodes_[leaf].balance, -twin.residual, arc.residual);
        arc.residual -= flow;
        twin.residual = 0;  // nothing flows back
        nodes_[leaf].balance -= flow;
        nodes_[arc.head()].balance += flow;
        label_[leaf] = kSettled;
        degree[leaf] = 0;
        leaves_.push_back({leaf, a});
        leaf = arc.head();
        --degree[leaf];
      }
    }
  }

  void restore_leaves() {
    while (!leaves_.empty()) {
      const auto [node, arc] = leaves_.back();
      leaves_.pop_back();
      const int64_t balance = nodes_[node].balance;
      const bool drains = balance < 0 || (balance == 0 && arcs_[arc].residual > 0 && can_drain(arcs_[arc].head()));
      label_[node] = drains ? kSettled : cut_off();
    }
  }

  void activate(int32_t node) {
    const int32_t label = label_[node];
    nodes_[node].active_next = std::exchange(active_first_[label], node);
    highest_active_ = std::max(highest_active_, label);
  }

  // Exact distances, breadth first from the draining nodes against the residual arcs. Then excess goes along the tree of
  // this search. Returns false if no excess can reach a draining node.
  bool relabel_globally() {
    std::fill_n(level_size_.begin(), highest_level_ + 1, 0);
    std::fill_n(active_first_.begin(), highest_level_ + 1, kNone);
    highest_active_ = 0;
    ceiling_ = num_nodes_;
    parked_.clear();
    slack_ = 3;  // 2 to 6 work equally well
    work_ = 0;

    int32_t back = 0;
    for (int32_t i = 0; i < num_nodes_; ++i) {
      if (label_[i] == kSettled) continue;
      label_[i] = nodes_[i].balance < 0 ? 1 : cut_off();
      if (label_[i] == 1) queue_[back++] = i;
    }
    for (int32_t front = 0; front < back; ++front) {
      const int32_t index = queue_[front];
      Node& node = nodes_[index];
      highest_level_ = node.exact_label = label_[index];
      ++level_size_[highest_level_];
      const int32_t end = nodes_[index + 1].first_arc;
      for (int32_t a = node.first_arc; a < end; ++a) {
        const int32_t neighbour = arcs_[a].head();
        if (label_[neighbour] != cut_off() || !arcs_[a].twin_open()) continue;
        label_[neighbour] = highest_level_ + 1;
        nodes_[neighbour].current_arc = arcs_[a].twin;  // until push_along_tree: the arc of the tree
        queue_[back++] = neighbour;
      }
    }
    return push_along_tree(back);
  }

  // Goes from the farthest node of the queue to the nearest, so each node also sends on the excess that it receives.
  // Nodes with remaining excess become active. Returns false if there was no excess.
  bool push_along_tree(int32_t queue_length) {
    bool any_excess = false;
    for (int32_t i = queue_length; i-- > 0;) {
      const int32_t index = queue_[i];
      Node& node = nodes_[index];
      any_excess |= node.balance > 0;
      if (node.balance > 0 && label_[index] > 1) move(node, arcs_[node.current_arc]);
      if (node.balance > 0) activate(index);
      node.current_arc = node.first_arc;
    }
    return any_excess;
  }

  void discharge_active() {
    while (highest_active_ > 0) {
      const int32_t node = active_first_[highest_active_];
      if (node == kNone) {
        --highest_active_;
        continue;
      }
      active_first_[highest_active_] = nodes_[node].active_next;
      discharge(node);
    }
  }

  // Activates the parked nodes when a global relabelling would not pay yet. Returns false if no node becomes active.
  bool unpark() {
    slack_ *= 2;
    for (int32_t node : parked_) {
      if (label_[node] < ceiling_) activate(node);
    }
    parked_.clear();
    return highest_active_ > 0;
  }

  // Moves the node's excess towards a drain and raises its label as needed, until no excess is left, the node is
  // parked, or no path exists.
  void discharge(int32_t index) {
    Node& node = nodes_[index];
    const int32_t end = nodes_[index + 1].first_arc;
    do {
      const int32_t below = label_[index] - 1;
      for (int32_t a = node.current_arc; a < end; ++a) {
        if (label_[arcs_[a].head()] != below || arcs_[a].residual == 0) continue;
        push(node, arcs_[a]);
        if (node.balance == 0) {
          node.current_arc = a;
          return;
        }
      }
    } while (relabel(index));
  }

  void push(Node& from, Arc& arc) {
    const bool was_active = nodes_[arc.head()].balance > 0;
    move(from, arc);
    if (!was_active && nodes_[arc.head()].balance > 0) activate(arc.head());
  }

  // Moves as much of the excess as the arc allows.
  void move(Node& from, Arc& arc) {
    const int64_t flow = std::min(from.balance, arc.residual);
    Arc& twin = arcs_[arc.twin];
    arc.residual -= flow;
    twin.residual += flow;
    arc.head_and_flag |= kTwinOpen;
    if (arc.residual == 0) twin.head_and_flag &= ~kTwinOpen;
    from.balance -= flow;
    nodes_[arc.head()].balance += flow;
  }

  // Returns false if the node must not be discharged further for now.
  bool relabel(int32_t index) {
    Node& node = nodes_[index];
    const int32_t end = nodes_[index + 1].first_arc;
    const int32_t old_label = label_[index];
    int32_t lowest = ceiling_;
    for (int32_t a = node.first_arc; a < end && lowest > old_label; ++a) {  // no lower label is possible
      if (label_[arcs_[a].head()] < lowest && arcs_[a].residual > 0) {
        lowest = label_[arcs_[a].head()];
        node.current_arc = a;
      }
    }
    work_ += 12 + (end - node.first_arc);
    // The gap heuristic: if no node has this label, nodes with higher labels have no path to a drain. None of them is
    // active, because the highest active node is discharged first.
    if (--level_size_[old_label] == 0) ceiling_ = old_label;
    if (lowest >= ceiling_) {
      label_[index] = cut_off();
      return false;
    }
    const int32_t label = label_[index] = lowest + 1;
    ++level_size_[label];
    highest_level_ = std::max(highest_level_, label);
    if (label <= node.exact_label + slack_) return true;
    parked_.push_back(index);
    return false;
  }

  int32_t num_nodes_;
  std::vector<Node> nodes_;  // one extra node marks the end of the last node's arcs
  std::vector<int32_t> label_;  // outside of Node, because labels are read most often and at random
  std::unique_ptr<Arc[]> arcs_;
  std::unique_ptr<int32_t[]> queue_;
  std::vector<int32_t> level_size_, active_first_, parked_;
  std::vector<Leaf> leaves_;
  int32_t highest_level_ = 0, highest_active_ = 0;
  int32_t ceiling_ = 0;  // nodes with labels >= ceiling_ have no path to a drain
  int64_t slack_ = 0;  // how far a label may rise above the exact label
  int64_t work_ = 0;  // since the last global relabelling
};

template <typename Value>
double largest_capacity(const Value* capacity, int64_t num_edges) {
  double largest = 0;
  for (int64_t e = 0; e < num_edges; ++e) {
    const double c = capacity[e];
    check(c >= 0 && std::isfinite(c), "capacity: expected finite numbers >= 0, got ", c, " at edge ", e);
    largest = std::max(largest, c);
  }
  return largest;
}

// Excess from each node's sink minus drain to its source (the problem is solved backwards, see the top). It is limited to
// kDecisive, because a terminal never needs more capacity than all edges together.
template <typename Source, typename Sink>
std::vector<int64_t> terminal_balances(const Source* source, const Sink* sink, int64_t num_nodes,
                                       const Quantiser& quantise) {
  std::vector<int64_t> balance(num_nodes, 0);
  for (int64_t i = 0; i < num_nodes; ++i) {
    if (source[i] == 0 && sink[i] == 0) continue;  // most nodes
    const double from = source[i], to = sink[i];
    check(from >= 0, "source_capacity: expected numbers >= 0, got ", from, " at node ", i);
    check(to >= 0, "sink_capacity: expected numbers >= 0, got ", to, " at node ", i);
    check(std::isfinite(from) || std::isfinite(to), "source_capacity and sink_capacity: both are infinite at node ", i,
          ", so no cut is finite");
    const int64_t magnitude = quantise(std::abs(to - from), kDecisive);
    balance[i] = to > from ? magnitude : -magnitude;
  }
  return balance;
}

template <typename Value>
double cut_edges(const int64_t* edge_index, const Value* capacity, int64_t num_edges, const bool* source_side) {
  double sum = 0;
  for (int64_t e = 0; e < num_edges; ++e) {
    if (source_side[edge_index[e]] != source_side[edge_index[num_edges + e]]) sum += capacity[e];
  }
  return sum;
}

template <typename Source, typename Sink>
double cut_terminals(const Source* source, const Sink* sink, int64_t num_nodes, const bool* source_side, double sum) {
  for (int64_t i = 0; i < num_nodes; ++i) sum += source_side[i] ? double{sink[i]} : double{source[i]};
  return sum;
}

std::tuple<Tensor, Tensor> min_cut(const Tensor& edge_index, const Tensor& capacity, const Tensor& source_capacity,
                                   const Tensor& sink_capacity) {
  const Tensor edges = checked_edge_index(edge_index);
  const int64_t num_edges = edges.size(1);
  check(2 * num_edges <= kMaxCount, "edge_index: expected fewer than 2^30 edges, got ", num_edges);
  const Tensor capacities = checked_values(capacity, num_edges, "capacity");
  check(source_capacity.dim() == 1, "source_capacity: expected shape [N]");
  const int64_t num_nodes = source_capacity.size(0);
  check(num_nodes < kMaxCount - 1, "source_capacity: expected fewer than 2^31 - 2 nodes, got ", num_nodes);
  const Tensor sources = checked_values(source_capacity, num_nodes, "source_capacity");
  const Tensor sinks = checked_values(sink_capacity, num_nodes, "sink_capacity");
  const auto with_terminals = [&](const auto& function) {
    return with_values(sources, [&](const auto* source) {
      return with_values(sinks, [&](const auto* sink) { return function(source, sink); });
    });
  };

  const int64_t* index = edges.const_data_ptr<int64_t>();
  Tensor side = torch::stable::new_empty(edges, {num_nodes}, ScalarType::Bool);
  Tensor flow = torch::stable::new_empty(edges, {}, ScalarType::Double);
  bool* source_side = side.mutable_data_ptr<bool>();

  with_values(capacities, [&](const auto* values) {
    const Quantiser quantise(largest_capacity(values, num_edges), num_edges);
    Preflow preflow(with_terminals(
        [&](const auto* source, const auto* sink) { return terminal_balances(source, sink, num_nodes, quantise); }));
    for (int64_t e = 0; e < num_edges; ++e) {
      const int64_t u = index[e], v = index[num_edges + e];
      check_ends(u, v, num_nodes, e);
      preflow.count_edge(u, v);
    }
    preflow.reserve_arcs();
    for (int64_t e = 0; e < num_edges; ++e) {
      preflow.add_edge(index[e], index[num_edges + e], quantise(values[e], int64_t{1} << 60));
    }
    preflow.solve();
    for (int64_t i = 0; i < num_nodes; ++i) source_side[i] = preflow.can_drain(i);
    const double cut = cut_edges(index, values, num_edges, source_side);
    *flow.mutable_data_ptr<double>() = with_terminals(
        [&](const auto* source, const auto* sink) { return cut_terminals(source, sink, num_nodes, source_side, cut); });
  });
  return {side, flow};
}

}  // namespace

TORCHJOINT_OPERATOR(min_cut,
                    "(Tensor edge_index, Tensor capacity, Tensor source_capacity, Tensor sink_capacity) -> (Tensor "
                    "source_side, Tensor flow)");

}  // namespace torchjoint
