// The undirected edges of a table of neighbours; each edge once.
#include "neighbors.h"

#include <bit>
#include <numeric>

namespace torchjoint {
namespace {

template <typename Index>
class EdgeList {
 public:
  EdgeList(const Index* neighbors, const RowOrder& order, int64_t num_rows, int64_t row_length)
      : neighbors_(neighbors), order_(order), num_rows_(num_rows), row_length_(row_length),
        words_((row_length + 63) / 64), kept_(num_rows * words_), start_(num_blocks(num_rows) + 1) {}

  // First the threads mark the edges of their rows, in any order; their numbers then tell each thread where to write.
  int64_t mark() {
    for_blocks_of_rows(neighbors_, num_rows_, row_length_, [&](int64_t, int64_t first, int64_t last) {
      for (int64_t place = first; place < last; ++place) {
        if (!mark_row(order_.row(place))) return false;
      }
      return true;
    });
    for_blocks_of_rows(neighbors_, num_rows_, row_length_, [&](int64_t block, int64_t first, int64_t last) {
      for (int64_t word = first * words_; word < last * words_; ++word) start_[block + 1] += std::popcount(kept_[word]);
      return true;
    });
    std::partial_sum(start_.begin(), start_.end(), start_.begin());
    return start_.back();
  }

  void write(int64_t* smaller, int64_t* larger) const {
    for_blocks_of_rows(neighbors_, num_rows_, row_length_, [&](int64_t block, int64_t first, int64_t last) {
      int64_t edge = start_[block];
      for (int64_t i = first; i < last; ++i) {
        for (int64_t k = 0; k < row_length_; ++k) {
          if (!(kept_[i * words_ + k / 64] >> (k % 64) & 1)) continue;
          const int64_t j = neighbors_[i * row_length_ + k];
          smaller[edge] = std::min(i, j);
          larger[edge++] = std::max(i, j);
        }
      }
      return true;
    });
  }

 private:
  // Marks the edges that occur first in row i; returns false if one of the row's numbers is outside [0, N).
  bool mark_row(int64_t i) {
    const Index* row = neighbors_ + i * row_length_;
    for (int64_t k = 0; k < row_length_; ++k) {
      const int64_t j = row[k];
      if (static_cast<uint64_t>(j) >= static_cast<uint64_t>(num_rows_)) return false;
      // An edge to an earlier row already occurred there if that row contains i. A self loop is no edge.
      if (j == i || (j < i && names(j, i))) continue;
      kept_[i * words_ + k / 64] |= uint64_t{1} << (k % 64);
    }
    return true;
  }

  bool names(int64_t row, int64_t node) const {
    const Index* names = neighbors_ + row * row_length_;
    bool found = false;
    for (int64_t k = 0; k < row_length_; ++k) found |= names[k] == node;
    return found;
  }

  const Index* neighbors_;
  const RowOrder& order_;
  int64_t num_rows_, row_length_, words_;
  std::vector<uint64_t> kept_;  // one bit per entry of the table
  std::vector<int64_t> start_;  // of each block's edges
};

Tensor neighbor_edges(const Tensor& neighbors, const std::optional<Tensor>& order) {
  const Tensor table = checked_neighbors(neighbors);
  const RowOrder rows(order, table.size(0));
  return with_indices(table, [&](const auto* indices) {
    EdgeList edges(indices, rows, table.size(0), table.size(1));
    const int64_t num_edges = edges.mark();
    Tensor edge_index = torch::stable::new_empty(table, {2, num_edges}, ScalarType::Long);
    int64_t* smaller = edge_index.mutable_data_ptr<int64_t>();
    edges.write(smaller, smaller + num_edges);
    return edge_index;
  });
}

}  // namespace

TORCHJOINT_OPERATOR(neighbor_edges, "(Tensor neighbors, Tensor? order=None) -> Tensor");

}  // namespace torchjoint
