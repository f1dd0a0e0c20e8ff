// Argument checks and tensor access, shared by all operators.
#pragma once

#include <torch/csrc/stable/library.h>
#include <torch/csrc/stable/ops.h>
#include <torch/csrc/stable/tensor.h>

#include <algorithm>
#include <cstdint>
#include <initializer_list>
#include <limits>
#include <sstream>
#include <stdexcept>
#include <vector>

// Registers a function with the name and the schema of an operator.
#define TORCHJOINT_OPERATOR(name, schema)                                            \
  STABLE_TORCH_LIBRARY_FRAGMENT(torchjoint, m) { m.def(#name schema); }              \
  STABLE_TORCH_LIBRARY_IMPL(torchjoint, CPU, m) { m.impl(#name, TORCH_BOX(&name)); } \
  static_assert(true)

namespace torchjoint {

using torch::headeronly::ScalarType;
using torch::stable::Tensor;

// Node and edge numbers are stored in 32 bits.
constexpr int64_t kMaxCount = std::numeric_limits<int32_t>::max();

// Throws an exception that Python sees as a ValueError. STD_TORCH_CHECK would add the path of this file to the message.
template <typename... Parts>
[[noreturn]] void fail(const Parts&... parts) {
  std::ostringstream message;
  (message << ... << parts);
  throw std::invalid_argument(message.str());
}

template <typename... Parts>
void check(bool condition, const Parts&... parts) {
  if (!condition) [[unlikely]]
    fail(parts...);
}

inline bool is_floating(const Tensor& tensor) {
  return tensor.scalar_type() == ScalarType::Float || tensor.scalar_type() == ScalarType::Double;
}

// Checks edges [2, E] int64 on the CPU; returns them contiguous.
inline Tensor checked_edge_index(const Tensor& edge_index) {
  check(edge_index.is_cpu(), "edge_index: expected a CPU tensor");
  check(edge_index.scalar_type() == ScalarType::Long, "edge_index: expected dtype torch.int64");
  check(edge_index.dim() == 2 && edge_index.size(0) == 2, "edge_index: expected shape [2, E]");
  check(edge_index.size(1) <= kMaxCount, "edge_index: expected at most 2^31 - 1 edges, got ", edge_index.size(1));
  return torch::stable::contiguous(edge_index);
}

// Checks a vector [length], float32 or float64 on the CPU; returns it contiguous.
inline Tensor checked_values(const Tensor& values, int64_t length, const char* name) {
  check(values.is_cpu(), name, ": expected a CPU tensor");
  check(is_floating(values), name, ": expected dtype torch.float32 or torch.float64");
  check(values.dim() == 1 && values.size(0) == length, name, ": expected shape [", length, "]");
  return torch::stable::contiguous(values);
}

// Checks dtype, shape and device (CPU); returns the tensor contiguous. In `shape`, -1 allows any length.
inline Tensor checked_array(const Tensor& tensor, ScalarType dtype, std::initializer_list<int64_t> shape,
                            const char* name) {
  check(tensor.is_cpu(), name, ": expected a CPU tensor");
  check(tensor.scalar_type() == dtype, name, ": expected another dtype");
  check(tensor.dim() == static_cast<int64_t>(shape.size()), name, ": expected ", shape.size(), " dimensions");
  int64_t dimension = 0;
  for (const int64_t length : shape) {
    const int64_t got = tensor.size(dimension++);
    check(length < 0 || got == length, name, ": expected length ", length, " in dimension ", dimension - 1, ", got ",
          got);
  }
  return torch::stable::contiguous(tensor);
}

// Checks that the pixels of an image can be numbered with 32 bits.
inline void check_image_size(int64_t height, int64_t width) {
  check(height >= 0 && width >= 0 && height <= kMaxCount && width <= kMaxCount && height * width <= kMaxCount,
        "height, width: expected an image of at most 2^31 - 1 pixels, got ", height, " x ", width);
}

// Checks that a value is one of 0, ..., count - 1; the error names the argument and the position.
inline void check_index(int64_t value, int64_t count, const char* name, int64_t position) {
  if (static_cast<uint64_t>(value) >= static_cast<uint64_t>(count)) [[unlikely]] {
    fail(name, ": expected numbers in [0, ", count, "), got ", value, " at ", position);
  }
}

// Checks numbers from `low` to `high`; the error begins with `expected`, and names the position.
inline void check_all(const float* values, int64_t count, float low, float high, const char* expected) {
  int32_t bad = 0;
  for (int64_t i = 0; i < count; ++i) bad |= !(values[i] >= low) | !(values[i] <= high);
  for (int64_t i = 0; bad && i < count; ++i) {
    check(values[i] >= low && values[i] <= high, expected, ", got ", values[i], " at ", i);
  }
}

// A new CPU tensor with the values of a vector; `like` is any CPU tensor.
template <typename T>
Tensor to_tensor(const std::vector<T>& values, ScalarType dtype, const Tensor& like) {
  Tensor tensor = torch::stable::new_empty(like, {static_cast<int64_t>(values.size())}, dtype);
  std::copy(values.begin(), values.end(), tensor.mutable_data_ptr<T>());
  return tensor;
}

// A new CPU tensor [2, M] int64 with the numbers of two vectors.
template <typename T>
Tensor to_pairs(const std::vector<T>& first, const std::vector<T>& second, const Tensor& like) {
  Tensor pairs = torch::stable::new_empty(like, {2, static_cast<int64_t>(first.size())}, ScalarType::Long);
  std::copy(second.begin(), second.end(), std::copy(first.begin(), first.end(), pairs.mutable_data_ptr<int64_t>()));
  return pairs;
}

// Checks the two ends of an edge.
inline void check_ends(int64_t u, int64_t v, int64_t num_nodes, int64_t edge) {
  for (const int64_t node : {u, v}) {
    check(static_cast<uint64_t>(node) < static_cast<uint64_t>(num_nodes), "edge_index: expected node numbers in [0, ",
          num_nodes, "), got ", node, " at edge ", edge);
  }
}

// Calls `function` with the tensor's data as `const float*` or `const double*`.
template <typename Function>
auto with_values(const Tensor& values, Function&& function) {
  if (values.scalar_type() == ScalarType::Float) return function(values.const_data_ptr<float>());
  return function(values.const_data_ptr<double>());
}

// Calls `function(i)` for i = 0, ..., count - 1 on torch's threads, `at_once` or more in one task.
template <typename Function>
void parallel_for_each(int64_t count, int64_t at_once, const Function& function) {
  torch::stable::parallel_for(0, count, at_once, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) function(i);
  });
}

// With sanitizers the compiler would need many minutes for a version without calls.
#if defined(__x86_64__) && !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
#define TORCHJOINT_AVX2
// Vectors of twice the length, without fused operations, so that results are the same.
template <typename Function>
__attribute__((target("avx2"), flatten)) void run_avx2(const Function& function) {
  function();
}
#endif

// Runs a function in the fastest version for this processor.
template <typename Function>
void run_fastest(const Function& function) {
#ifdef TORCHJOINT_AVX2
  if (__builtin_cpu_supports("avx2")) return run_avx2(function);
#endif
  function();
}

}  // namespace torchjoint
