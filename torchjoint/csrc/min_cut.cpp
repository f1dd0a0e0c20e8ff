// Minimum s-t cut by preflow-push: A. Goldberg, R. Tarjan, "A New Approach to the Maximum-Flow Problem", J. ACM 1988,
// with highest-label selection, global relabelling and the gap heuristic (B. Cherkassky, A. Goldberg, "On
// Implementing Push-Relabel Method for the Maximum Flow Problem", Algorithmica 1997).
//
// Only the first phase is run, which finds the cut but not the flow. A maximum preflow tells which nodes can still
// reach the *sink*, the minimal sink side. Here the minimal source side is wanted: the edges are undirected, so the
// problem is solved backwards. Excess starts at the caller's sinks and is drained at the caller's sources.
#include "common.h"

#include <algorithm>
#include <cmath>
#include <tuple>
#include <utility>
#include <vector>

namespace torchjoint {
namespace {

struct Arc {
  int64_t residual;
  int32_t head;
  int32_t twin;  // the same edge, seen from the other end
};

struct Node {
  int64_t balance = 0;  // > 0: excess that has to be drained; < 0: what this node can still drain
  int32_t first_arc = 0;
  int32_t current_arc = 0;  // no arc before this one is admissible
  int32_t label = 0;        // lower bound of the distance to a draining node, which itself has label 1
  int32_t active_next = 0;
  int32_t level_next = 0, level_prev = 0;
};

constexpr int32_t kNone = -1;

// Doubles to integers, by a power of two: sums are then exact, the order of operations does not matter, and the
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

  // Zero stays zero, and what is positive stays positive. `largest` bounds the result.
  int64_t operator()(double value, int64_t largest) const {
    if (value == 0) return 0;
    const double scaled = value * scale_;
    if (scaled >= 0x1p62) return largest;  // and not `>= largest`, which a double may be unable to hold
    return std::clamp<int64_t>(std::llrint(scaled), 1, largest);
  }

 private:
  double scale_;
};

class Preflow {
 public:
  // Degrees first, then arcs: the arcs of a node lie together, in the order of the edges.
  Preflow(int64_t num_nodes, int64_t num_edges, const int64_t* edge_index)
      : num_nodes_(static_cast<int32_t>(num_nodes)), nodes_(num_nodes + 1), level_first_(num_nodes + 2, kNone),
        active_first_(num_nodes + 2, kNone) {
    for (int64_t e = 0; e < num_edges; ++e) {
      const int64_t u = edge_index[e], v = edge_index[num_edges + e];
      check_node(u, num_nodes, e);
      check_node(v, num_nodes, e);
      if (u != v) ++nodes_[u].first_arc, ++nodes_[v].first_arc;
    }
    int32_t start = 0;
    for (Node& node : nodes_) {
      node.current_arc = start;  // for now: where the node's next arc goes
      start += std::exchange(node.first_arc, start);
    }
    arcs_.resize(start);
  }

  void add_edge(int64_t u, int64_t v, int64_t capacity) {
    const int32_t there = nodes_[u].current_arc++, back = nodes_[v].current_arc++;
    arcs_[there] = {capacity, static_cast<int32_t>(v), back};
    arcs_[back] = {capacity, static_cast<int32_t>(u), there};
  }

  void set_balance(int64_t node, int64_t balance) { nodes_[node].balance = balance; }

  int64_t incident_capacity(int64_t node) const {
    int64_t sum = 0;
    for (int32_t a = nodes_[node].first_arc; a < nodes_[node + 1].first_arc; ++a) sum += arcs_[a].residual;
    return sum;
  }

  void solve() {
    relabel_globally();
    // A global relabelling costs about as much as this much work between two of them.
    const int64_t work_limit = 12 * static_cast<int64_t>(num_nodes_) + 2 * static_cast<int64_t>(arcs_.size());
    while (highest_active_ > 0) {
      const int32_t node = active_first_[highest_active_];
      if (node == kNone) {
        --highest_active_;
        continue;
      }
      active_first_[highest_active_] = nodes_[node].active_next;
      discharge(node);
      if (work_ > work_limit) relabel_globally();
    }
    relabel_globally();
  }

  // After solve(): whether the node can still reach a draining node.
  bool can_drain(int64_t node) const { return nodes_[node].label <= num_nodes_; }

 private:
  int32_t unreachable() const { return num_nodes_ + 1; }

  void activate(int32_t node) {
    Node& n = nodes_[node];
    n.active_next = active_first_[n.label];
    active_first_[n.label] = node;
    highest_active_ = std::max(highest_active_, n.label);
  }

  void enter_level(int32_t node, int32_t label) {
    Node& n = nodes_[node];
    n.label = label;
    n.level_prev = kNone;
    n.level_next = level_first_[label];
    if (n.level_next != kNone) nodes_[n.level_next].level_prev = node;
    level_first_[label] = node;
    highest_level_ = std::max(highest_level_, label);
  }

  void leave_level(int32_t node) {
    const Node& n = nodes_[node];
    if (n.level_next != kNone) nodes_[n.level_next].level_prev = n.level_prev;
    if (n.level_prev != kNone) {
      nodes_[n.level_prev].level_next = n.level_next;
    } else {
      level_first_[n.label] = n.level_next;
    }
  }

  // Exact distances, breadth first from the draining nodes against the residual arcs.
  void relabel_globally() {
    work_ = 0;
    std::fill_n(level_first_.begin(), highest_level_ + 1, kNone);
    std::fill_n(active_first_.begin(), highest_level_ + 1, kNone);
    highest_level_ = highest_active_ = 0;
    queue_.clear();
    for (int32_t i = 0; i < num_nodes_; ++i) {
      nodes_[i].label = unreachable();
      nodes_[i].current_arc = nodes_[i].first_arc;
      if (nodes_[i].balance < 0) {
        enter_level(i, 1);
        queue_.push_back(i);
      }
    }
    for (size_t front = 0; front < queue_.size(); ++front) {
      const int32_t node = queue_[front];
      const int32_t label = nodes_[node].label + 1;
      for (int32_t a = nodes_[node].first_arc; a < nodes_[node + 1].first_arc; ++a) {
        const int32_t neighbour = arcs_[a].head;
        if (nodes_[neighbour].label <= num_nodes_ || arcs_[arcs_[a].twin].residual == 0) continue;
        enter_level(neighbour, label);
        queue_.push_back(neighbour);
        if (nodes_[neighbour].balance > 0) activate(neighbour);
      }
    }
  }

  void push(Node& from, Arc& arc) {
    const int64_t amount = std::min(from.balance, arc.residual);
    arc.residual -= amount;
    arcs_[arc.twin].residual += amount;
    from.balance -= amount;
    Node& to = nodes_[arc.head];
    const bool was_active = to.balance > 0;
    to.balance += amount;
    if (!was_active && to.balance > 0) activate(arc.head);
  }

  // Moves the node's excess nearer to a drain, raising its label as needed, until nothing is left or no way exists.
  void discharge(int32_t index) {
    Node& node = nodes_[index];
    const int32_t end = nodes_[index + 1].first_arc;
    while (true) {
      for (int32_t a = node.current_arc; a < end; ++a) {
        Arc& arc = arcs_[a];
        if (arc.residual == 0 || nodes_[arc.head].label + 1 != node.label) continue;
        push(node, arc);
        if (node.balance == 0) {
          node.current_arc = a;
          return;
        }
      }
      if (!relabel(index)) return;
    }
  }

  // False if the node turns out to be cut off from all drains.
  bool relabel(int32_t index) {
    Node& node = nodes_[index];
    const int32_t end = nodes_[index + 1].first_arc;
    int32_t lowest = num_nodes_, lowest_arc = end;
    for (int32_t a = node.first_arc; a < end; ++a) {
      if (arcs_[a].residual > 0 && nodes_[arcs_[a].head].label < lowest) {
        lowest = nodes_[arcs_[a].head].label;
        lowest_arc = a;
      }
    }
    work_ += 12 + (end - node.first_arc);
    const int32_t old_label = node.label;
    leave_level(index);
    if (level_first_[old_label] == kNone) {
      cut_off_above(old_label);
      node.label = unreachable();
      return false;
    }
    if (lowest_arc == end) {
      node.label = unreachable();
      return false;
    }
    enter_level(index, lowest + 1);
    node.current_arc = lowest_arc;
    return true;
  }

  // The gap heuristic: no label is `gap`, so nothing above it has a way down. None of those nodes is active, since
  // the highest active node is discharged first.
  void cut_off_above(int32_t gap) {
    for (int32_t level = gap + 1; level <= highest_level_; ++level) {
      for (int32_t i = level_first_[level]; i != kNone; i = nodes_[i].level_next) nodes_[i].label = unreachable();
      level_first_[level] = kNone;
    }
    highest_level_ = gap;
  }

  int32_t num_nodes_;
  std::vector<Node> nodes_;  // one more than there are, for the end of the last node's arcs
  std::vector<Arc> arcs_;
  std::vector<int32_t> level_first_, active_first_, queue_;
  int32_t highest_level_ = 0, highest_active_ = 0;
  int64_t work_ = 0;
};

template <typename Value>
double largest_capacity(const Value* capacity, int64_t num_edges) {
  double largest = 0;
  for (int64_t e = 0; e < num_edges; ++e) {
    const double c = capacity[e];
    if (!(c >= 0 && std::isfinite(c))) [[unlikely]] {
      fail("capacity: expected finite numbers >= 0, got ", c, " at edge ", e);
    }
    largest = std::max(largest, c);
  }
  return largest;
}

std::vector<double> read_terminal(const Tensor& terminal, int64_t num_nodes, const char* name) {
  std::vector<double> result(num_nodes);
  with_values(terminal, [&](const auto* values) { std::copy_n(values, num_nodes, result.begin()); });
  for (int64_t i = 0; i < num_nodes; ++i) {
    if (!(result[i] >= 0)) [[unlikely]] fail(name, ": expected numbers >= 0, got ", result[i], " at node ", i);
  }
  return result;
}

// What a node draws from its terminals: > 0 from the sink, < 0 from the source (see the top: solved backwards). No
// terminal has to be larger than all edges of its node together: one more already decides the node's side.
int64_t terminal_balance(double source, double sink, int64_t incident, const Quantiser& quantise) {
  const double difference = source - sink;
  const int64_t magnitude = quantise(std::abs(difference), incident + 1);
  return difference > 0 ? -magnitude : magnitude;
}

template <typename Value>
double cut_capacity(const int64_t* edge_index, const Value* capacity, int64_t num_edges, const bool* source_side,
                    const std::vector<double>& source, const std::vector<double>& sink) {
  double sum = 0;
  for (int64_t e = 0; e < num_edges; ++e) {
    if (source_side[edge_index[e]] != source_side[edge_index[num_edges + e]]) sum += capacity[e];
  }
  for (size_t i = 0; i < source.size(); ++i) sum += source_side[i] ? sink[i] : source[i];
  return sum;
}

std::tuple<Tensor, Tensor> min_cut(
    const Tensor& edge_index, const Tensor& capacity, const Tensor& source_capacity, const Tensor& sink_capacity) {
  const Tensor edges = checked_edge_index(edge_index);
  const int64_t num_edges = edges.size(1);
  check(2 * num_edges <= kMaxCount, "edge_index: expected fewer than 2^30 edges, got ", num_edges);
  const Tensor capacities = checked_values(capacity, num_edges, "capacity");
  check(source_capacity.dim() == 1, "source_capacity: expected shape [N]");
  const int64_t num_nodes = source_capacity.size(0);
  check(num_nodes < kMaxCount - 1, "source_capacity: expected fewer than 2^31 - 2 nodes, got ", num_nodes);
  const auto source =
      read_terminal(checked_values(source_capacity, num_nodes, "source_capacity"), num_nodes, "source_capacity");
  const auto sink =
      read_terminal(checked_values(sink_capacity, num_nodes, "sink_capacity"), num_nodes, "sink_capacity");
  for (int64_t i = 0; i < num_nodes; ++i) {
    check(std::isfinite(source[i]) || std::isfinite(sink[i]),
          "source_capacity and sink_capacity: both are infinite at node ", i, ", so no cut is finite");
  }

  const int64_t* index = edges.const_data_ptr<int64_t>();
  Tensor side = torch::stable::new_empty(edges, {num_nodes}, ScalarType::Bool);
  Tensor flow = torch::stable::new_empty(edges, {}, ScalarType::Double);
  bool* source_side = side.mutable_data_ptr<bool>();

  with_values(capacities, [&](const auto* values) {
    const Quantiser quantise(largest_capacity(values, num_edges), num_edges);
    Preflow preflow(num_nodes, num_edges, index);
    for (int64_t e = 0; e < num_edges; ++e) {
      const int64_t u = index[e], v = index[num_edges + e];
      if (u != v) preflow.add_edge(u, v, quantise(values[e], int64_t{1} << 60));
    }
    for (int64_t i = 0; i < num_nodes; ++i) {
      preflow.set_balance(i, terminal_balance(source[i], sink[i], preflow.incident_capacity(i), quantise));
    }
    preflow.solve();
    for (int64_t i = 0; i < num_nodes; ++i) source_side[i] = preflow.can_drain(i);
    *flow.mutable_data_ptr<double>() = cut_capacity(index, values, num_edges, source_side, source, sink);
  });
  return {side, flow};
}

}  // namespace

STABLE_TORCH_LIBRARY_FRAGMENT(torchjoint, m) {
  m.def(
      "min_cut(Tensor edge_index, Tensor capacity, Tensor source_capacity, Tensor sink_capacity)"
      " -> (Tensor source_side, Tensor flow)");
}

STABLE_TORCH_LIBRARY_IMPL(torchjoint, CPU, m) {
  m.impl("min_cut", TORCH_BOX(&min_cut));
}

}  // namespace torchjoint
