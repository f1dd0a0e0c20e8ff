// Checks and tensor access shared by the ops.
#pragma once

#include <torch/csrc/stable/library.h>
#include <torch/csrc/stable/ops.h>
#include <torch/csrc/stable/tensor.h>

#include <cstdint>
#include <limits>
#include <sstream>
#include <stdexcept>

namespace torchjoint {

using torch::headeronly::ScalarType;
using torch::stable::Tensor;

// Node and edge numbers are stored in 32 bits.
constexpr int64_t kMaxCount = std::numeric_limits<int32_t>::max();

// Throws what Python sees as a ValueError. Not STD_TORCH_CHECK: its message would carry the path of this source file.
template <typename... Parts>
[[noreturn]] void fail(const Parts&... parts) {
  std::ostringstream message;
  (message << ... << parts);
  throw std::invalid_argument(message.str());
}

template <typename... Parts>
void check(bool condition, const Parts&... parts) {
  if (!condition) [[unlikely]] fail(parts...);
}

inline bool is_floating(const Tensor& tensor) {
  return tensor.scalar_type() == ScalarType::Float || tensor.scalar_type() == ScalarType::Double;
}

// [2, E] int64 on the CPU, contiguous.
inline Tensor checked_edge_index(const Tensor& edge_index) {
  check(edge_index.is_cpu(), "edge_index: expected a CPU tensor");
  check(edge_index.scalar_type() == ScalarType::Long, "edge_index: expected dtype torch.int64");
  check(edge_index.dim() == 2 && edge_index.size(0) == 2, "edge_index: expected shape [2, E]");
  check(edge_index.size(1) <= kMaxCount, "edge_index: expected at most 2^31 - 1 edges, got ", edge_index.size(1));
  return torch::stable::contiguous(edge_index);
}

// [length] float32 or float64 on the CPU, contiguous.
inline Tensor checked_values(const Tensor& values, int64_t length, const char* name) {
  check(values.is_cpu(), name, ": expected a CPU tensor");
  check(is_floating(values), name, ": expected dtype torch.float32 or torch.float64");
  check(values.dim() == 1 && values.size(0) == length, name, ": expected shape [", length, "]");
  return torch::stable::contiguous(values);
}

inline void check_node(int64_t node, int64_t num_nodes, int64_t edge) {
  if (static_cast<uint64_t>(node) >= static_cast<uint64_t>(num_nodes)) [[unlikely]] {
    fail("edge_index: expected node numbers in [0, ", num_nodes, "), got ", node, " at edge ", edge);
  }
}

// Calls `function` with the tensor's data as `const float*` or `const double*`.
template <typename Function>
auto with_values(const Tensor& values, Function&& function) {
  if (values.scalar_type() == ScalarType::Float) return function(values.const_data_ptr<float>());
  return function(values.const_data_ptr<double>());
}

}  // namespace torchjoint
