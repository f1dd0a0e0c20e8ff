// Points of a tree that may be neighbours of a place, and their squared distances from this place.
#pragma once

#include "point_tree.h"

#include <algorithm>
#include <bit>
#include <limits>
#include <vector>

#ifdef __SSE2__
#include <emmintrin.h>
#endif

namespace torchjoint {

// An upper limit for squared distances up to `squared` that were computed in Value with rounding errors.
template <typename Value>
Value rounded_up(double squared) {
  constexpr double margin = 16 * double{std::numeric_limits<Value>::epsilon()};
  const double larger = squared * (1 + margin) + 16 * double{std::numeric_limits<Value>::min()};
  constexpr Value largest = std::numeric_limits<Value>::max();
  return larger < largest ? static_cast<Value>(larger) : std::numeric_limits<Value>::infinity();
}

// Compares four values; bit i is 1 if values[i] <= limit.
#ifdef __SSE2__
inline uint32_t up_to(const float* values, float limit) {
  return _mm_movemask_ps(_mm_cmple_ps(_mm_loadu_ps(values), _mm_set1_ps(limit)));
}
inline uint32_t up_to(const double* values, double limit) {
  const auto two = [&](const double* at) {
    return _mm_movemask_pd(_mm_cmple_pd(_mm_loadu_pd(at), _mm_set1_pd(limit)));
  };
  return two(values) | two(values + 2) << 2;
}
#else
template <typename Value>
uint32_t up_to(const Value* values, Value limit) {
  uint32_t bits = 0;
  for (int i = 0; i < 4; ++i) bits |= static_cast<uint32_t>(values[i] <= limit) << i;
  return bits;
}
#endif

// Calls `function` with the index of each value <= limit. One loop over the bits of 64 values has one unpredictable
// branch, its end; a test of each value would have 64.
template <typename Value, typename Function>
void for_each_up_to(const Value* values, size_t size, Value limit, const Function& function) {
  for (size_t start = 0; start < size; start += 64) {
    const size_t end = std::min(start + 64, size);
    uint64_t bits = 0;
    size_t i = start;
    for (; i + 4 <= end; i += 4) bits |= uint64_t{up_to(values + i, limit)} << (i - start);
    for (; i < end; ++i) bits |= uint64_t{values[i] <= limit} << (i - start);
    for (; bits; bits &= bits - 1) function(start + std::countr_zero(bits));
  }
}

// Points that may be neighbours, one array per coordinate, and their squared distances from a place, rounded to Value.
template <typename Value>
struct Candidates {
  static constexpr int64_t kLeafSize = PointTree<Value>::kLeafSize;

  std::vector<Value> at[3], distance;
  std::vector<int32_t> index;
  size_t size = 0;

  void add(const typename PointTree<Value>::Leaf& leaf, int64_t count) {
    if (size + kLeafSize > index.size()) {
      for (auto& values : at) values.resize(2 * (size + kLeafSize));
      distance.resize(2 * (size + kLeafSize));
      index.resize(2 * (size + kLeafSize));
    }
    for (int d = 0; d < 3; ++d) std::copy_n(leaf.at[d], kLeafSize, at[d].data() + size);
    std::copy_n(leaf.index, kLeafSize, index.data() + size);
    size += count;
  }

  void measure(const Value* place) {
    const Value *xs = at[0].data(), *ys = at[1].data(), *zs = at[2].data();
    Value* squared = distance.data();
    const Value px = place[0], py = place[1], pz = place[2];
    for (size_t i = 0; i < size; ++i) {
      const Value x = xs[i] - px, y = ys[i] - py, z = zs[i] - pz;
      squared[i] = (x * x + y * y) + z * z;
    }
  }

  void keep_up_to(Value limit) {
    size_t kept = 0;
    for_each_up_to(distance.data(), size, limit, [&](size_t i) {
      for (auto& values : at) values[kept] = values[i];
      index[kept++] = index[i];
    });
    size = kept;
  }
};

template <typename Value>
size_t count_up_to(const Value* values, size_t size, Value limit) {
  uint32_t count = 0;  // as wide as a float: so vectors of both have the same length
  for (size_t i = 0; i < size; ++i) count += values[i] <= limit;
  return count;
}

// A limit below or at which there are at least `wanted` of the values, but not many more; `high` is such a limit. On a
// surface the number of points grows linearly with the squared distance, so interpolation finds the limit fast. It does
// not in a clump that is tiny beside the distances of other points; there the values are partly sorted.
template <typename Value>
Value threshold(const Value* values, size_t size, size_t wanted, Value high, Value guess) {
  const size_t enough = wanted + wanted / 4 + 2;
  Value low = 0;
  size_t below = 0, up_to_high = size;
  for (int tries = 0; tries < 16 && up_to_high > enough && guess < high; ++tries) {
    const size_t within = count_up_to(values, size, guess);
    if (within < wanted) {
      if (tries == 0) up_to_high = count_up_to(values, size, high);
      low = guess, below = within;
    } else {
      high = guess, up_to_high = within;
    }
    const double share = (1.1 * wanted + 1 - below) / (up_to_high - below);
    guess = static_cast<Value>(low + (high - low) * std::clamp(share, 1e-4, 0.9));
  }
  if (up_to_high <= 8 * enough) return high;
  std::vector<Value> copy(values, values + size);
  std::nth_element(copy.begin(), copy.begin() + wanted - 1, copy.end());
  return std::min(high, copy[wanted - 1]);
}

}  // namespace torchjoint
