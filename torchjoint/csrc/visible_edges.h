// The edges of a graph whose two ends are visible in an image.
#pragma once

#include "common.h"

#include <cstdint>
#include <tuple>
#include <vector>

namespace torchjoint {

// Walks a graph in CSR form (see cloud/graph.py). M points are visible; the slot of a point is its index among them.
class VisibleEdges {
 public:
  VisibleEdges(const Tensor& order, const Tensor& other_end, const Tensor& start, const Tensor& point,
               const Tensor& row, const Tensor& column, int64_t height, int64_t width)
      : order_(checked_array(order, ScalarType::Int, {-1}, "order")),
        other_end_(checked_array(other_end, ScalarType::Int, {order_.size(0)}, "other_end")),
        start_(checked_array(start, ScalarType::Int, {-1}, "start")),
        point_(checked_array(point, ScalarType::Long, {-1}, "point")),
        row_(checked_array(row, ScalarType::Long, {point_.size(0)}, "row")),
        column_(checked_array(column, ScalarType::Long, {point_.size(0)}, "column")), num_nodes_(start_.size(0) - 1),
        num_points(point_.size(0)), rows(row_.const_data_ptr<int64_t>()), columns(column_.const_data_ptr<int64_t>()) {
    check(num_nodes_ >= 0, "start: expected shape [N + 1], got [0]");
    check_image_size(height, width);
    slot_.assign(num_nodes_, -1);
    const int32_t* const first_of = start_.const_data_ptr<int32_t>();
    const int64_t* const node = point_.const_data_ptr<int64_t>();
    for (int64_t i = 0; i < num_points; ++i) {
      check_index(node[i], num_nodes_, "point", i);
      check_index(rows[i], height, "row", i);
      check_index(columns[i], width, "column", i);
      check(slot_[node[i]] < 0, "point: expected every point once, got ", node[i], " again at ", i);
      slot_[node[i]] = static_cast<int32_t>(i);
      const int32_t begin = first_of[node[i]], end = first_of[node[i] + 1];
      check(begin >= 0 && begin <= end && end <= order_.size(0), "start: expected ascending numbers in [0, E]");
      at_most_ += end - begin;
    }
  }

  // The edges, and their values, in the order of the points, then of their edges. `measure(slot, slot of the other end,
  // value)` writes the value of an edge; if it returns false, the edge is left out.
  template <typename Value, typename Measure>
  std::tuple<Tensor, Tensor> values(ScalarType dtype, const Measure& measure) const {
    Tensor edge = torch::stable::new_empty(order_, {at_most_}, ScalarType::Long);
    Tensor value = torch::stable::new_empty(order_, {at_most_}, dtype);
    int64_t* const edges = edge.mutable_data_ptr<int64_t>();
    Value* const values = value.mutable_data_ptr<Value>();
    const int32_t* const edge_at = order_.const_data_ptr<int32_t>();
    const int32_t* const other_at = other_end_.const_data_ptr<int32_t>();
    const int32_t* const first_of = start_.const_data_ptr<int32_t>();
    const int64_t* const node = point_.const_data_ptr<int64_t>();
    const int32_t* const slot = slot_.data();
    const int64_t num_nodes = num_nodes_;
    int64_t count = 0;
    for (int32_t i = 0; i < num_points; ++i) {
      const int32_t end = first_of[node[i] + 1];
      for (int32_t place = first_of[node[i]]; place < end; ++place) {
        check_index(other_at[place], num_nodes, "other_end", place);
        const int32_t there = slot[other_at[place]];
        if (there >= 0 && measure(i, there, values[count])) edges[count++] = edge_at[place];
      }
    }
    return {torch::stable::narrow(edge, 0, 0, count), torch::stable::narrow(value, 0, 0, count)};
  }

 private:
  const Tensor order_, other_end_, start_, point_, row_, column_;
  const int64_t num_nodes_;
  // Number of edges that start at visible points. Most of them are visible, so memory for all is cheaper than arrays
  // that grow.
  int64_t at_most_ = 0;
  std::vector<int32_t> slot_;  // of a node; -1: not seen

 public:
  const int64_t num_points;
  const int64_t *const rows, *const columns;  // pixels of the points, [M]
};

}  // namespace torchjoint
