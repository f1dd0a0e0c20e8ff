// A table of neighbours, [N, K] int32 or int64: its checks, and a parallel loop over its rows.
#pragma once

#include "common.h"

#include <algorithm>
#include <optional>
#include <vector>

namespace torchjoint {

// Number of rows in a block. It does not change the result.
constexpr int64_t kRowsPerBlock = 1024;

inline int64_t num_blocks(int64_t num_rows) { return (num_rows + kRowsPerBlock - 1) / kRowsPerBlock; }

// Checks a table [N, K], int32 or int64 on the CPU; returns it contiguous.
inline Tensor checked_neighbors(const Tensor& neighbors) {
  check(neighbors.is_cpu(), "neighbors: expected a CPU tensor");
  check(neighbors.scalar_type() == ScalarType::Int || neighbors.scalar_type() == ScalarType::Long,
        "neighbors: expected dtype torch.int32 or torch.int64");
  check(neighbors.dim() == 2, "neighbors: expected shape [N, K]");
  check(neighbors.size(0) <= kMaxCount, "neighbors: expected at most 2^31 - 1 points, got ", neighbors.size(0));
  return torch::stable::contiguous(neighbors);
}

// Calls `function` with the table's data as `const int32_t*` or `const int64_t*`.
template <typename Function>
auto with_indices(const Tensor& indices, Function&& function) {
  if (indices.scalar_type() == ScalarType::Int) return function(indices.const_data_ptr<int32_t>());
  return function(indices.const_data_ptr<int64_t>());
}

// The order in which rows are processed, [N] int32; none: 0, 1, ... It does not change the result. If consecutive rows
// contain the same points, more of these points are in the processor's cache.
class RowOrder {
 public:
  RowOrder(const std::optional<Tensor>& order, int64_t num_rows) {
    if (!order) return;
    order_ = checked_array(*order, ScalarType::Int, {num_rows}, "order");
    rows_ = order_->const_data_ptr<int32_t>();
    std::vector<bool> seen(num_rows);
    for (int64_t place = 0; place < num_rows; ++place) {
      check_index(rows_[place], num_rows, "order", place);
      check(!seen[rows_[place]], "order: expected a permutation, got ", rows_[place], " again at ", place);
      seen[rows_[place]] = true;
    }
  }

  int64_t row(int64_t place) const { return rows_ == nullptr ? place : rows_[place]; }

 private:
  std::optional<Tensor> order_;
  const int32_t* rows_ = nullptr;
};

// Calls `function(block, first_row, last_row)` for all blocks of rows, on torch's threads. An exception must not leave
// a parallel loop. So `function` returns whether all numbers in its rows are in [0, N); after the loop, the first
// invalid number is reported.
template <typename Index, typename Function>
void for_blocks_of_rows(const Index* neighbors, int64_t num_rows, int64_t row_length, const Function& function) {
  const int64_t blocks = num_blocks(num_rows);
  std::vector<char> valid(blocks);
  parallel_for_each(blocks, 1, [&](int64_t block) {
    const int64_t first = block * kRowsPerBlock;
    valid[block] = function(block, first, std::min(first + kRowsPerBlock, num_rows));
  });
  if (std::find(valid.begin(), valid.end(), 0) == valid.end()) return;
  const Index* bad = std::find_if(neighbors, neighbors + num_rows * row_length,
                                  [&](Index j) { return static_cast<uint64_t>(j) >= static_cast<uint64_t>(num_rows); });
  fail("neighbors: expected point numbers in [0, ", num_rows, "), got ", *bad, " in row ",
       (bad - neighbors) / row_length);
}

}  // namespace torchjoint
