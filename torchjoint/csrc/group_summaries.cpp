// Mean and quantiles of the values in each group. The values are ranked once for many groupings: one pass over the
// ranks then meets the values of each group in ascending order, and nothing is sorted.
#include "array.h"
#include "common.h"

#include <cmath>
#include <limits>
#include <vector>

namespace torchjoint {
namespace {

// How many values of a group the pass over the ranks has met, and how many it must have met before each quantile.
struct Groups {
  Groups(int64_t num_groups, int64_t num_quantiles)
      : sum(num_groups, 0.0), count(num_groups, 0), met(num_groups, 0), before(num_groups * num_quantiles, 0) {}

  // The place of a quantile among n values is (n - 1) q in float32, rounded half to even.
  void place(const float* quantiles, int64_t num_quantiles) {
    for (size_t group = 0; group < count.size(); ++group) {
      for (int64_t q = 0; q < num_quantiles; ++q) {
        const float last = static_cast<float>(count[group] - 1);
        before[group * num_quantiles + q] = static_cast<int32_t>(std::nearbyint(last * quantiles[q]));
      }
    }
  }

  std::vector<double> sum;
  std::vector<int32_t> count, met, before;
};

Tensor group_summaries(const Tensor& values, const Tensor& rank, const Tensor& ascending, const Tensor& group,
                       int64_t num_groups, const Tensor& quantiles) {
  const Tensor of_values = checked_array(values, ScalarType::Float, {-1}, "values");
  const int64_t num_values = of_values.size(0);
  check(num_values <= kMaxCount, "values: expected at most 2^31 - 1, got ", num_values);
  const Tensor ranks = checked_array(rank, ScalarType::Long, {num_values}, "rank");
  const Tensor sorted = checked_array(ascending, ScalarType::Float, {num_values}, "ascending");
  const Tensor groups = checked_array(group, ScalarType::Long, {num_values}, "group");
  const Tensor shares = checked_array(quantiles, ScalarType::Float, {-1}, "quantiles");
  check(num_groups >= 0 && num_groups <= kMaxCount, "num_groups: expected 0 to 2^31 - 1, got ", num_groups);
  const int64_t num_quantiles = shares.size(0);
  const float* const share = shares.const_data_ptr<float>();
  for (int64_t q = 0; q < num_quantiles; ++q) {
    check(share[q] >= 0 && share[q] <= 1, "quantiles: expected numbers in [0, 1], got ", share[q], " at ", q);
  }

  Groups found(num_groups, num_quantiles);
  Array<int32_t> at_rank(num_values);
  std::fill_n(at_rank.data(), num_values, -1);
  const float* const in_order = sorted.const_data_ptr<float>();
  const float* const value = of_values.const_data_ptr<float>();
  const int64_t *const place = ranks.const_data_ptr<int64_t>(), *const of = groups.const_data_ptr<int64_t>();
  for (int64_t i = 0; i < num_values; ++i) {
    check_index(place[i], num_values, "rank", i);
    if (of[i] == -1) continue;
    check_index(of[i], num_groups, "group", i);
    if (!std::isfinite(value[i])) continue;
    check(at_rank[place[i]] < 0, "rank: expected a permutation, got ", place[i], " again at ", i);
    found.sum[of[i]] += value[i];
    ++found.count[of[i]];
    at_rank[place[i]] = static_cast<int32_t>(of[i]);
  }
  for (int64_t i = 0; i < num_values; ++i) {
    if (of[i] == -1 || !std::isfinite(value[i])) continue;
    check(in_order[place[i]] == value[i], "ascending: expected the value of each rank, got another at ", place[i]);
  }
  found.place(share, num_quantiles);

  Tensor result = torch::stable::new_empty(of_values, {num_groups, 1 + num_quantiles}, ScalarType::Double);
  double* const out = result.mutable_data_ptr<double>();
  std::fill_n(out, num_groups * (1 + num_quantiles), std::numeric_limits<double>::quiet_NaN());
  for (int64_t g = 0; g < num_groups; ++g) {
    if (found.count[g] > 0) out[g * (1 + num_quantiles)] = found.sum[g] / found.count[g];
  }
  float last = -std::numeric_limits<float>::infinity();
  for (int64_t r = 0; r < num_values; ++r) {
    const int64_t g = at_rank[r];
    if (g < 0) continue;
    check(in_order[r] >= last, "ascending: expected ascending numbers, got a smaller one at ", r);
    last = in_order[r];
    const int32_t met = found.met[g]++;
    for (int64_t q = 0; q < num_quantiles; ++q) {
      if (met == found.before[g * num_quantiles + q]) out[g * (1 + num_quantiles) + 1 + q] = in_order[r];
    }
  }
  return result;
}

}  // namespace

STABLE_TORCH_LIBRARY_FRAGMENT(torchjoint, m) {
  m.def(
      "group_summaries(Tensor values, Tensor rank, Tensor ascending, Tensor group, int num_groups, Tensor quantiles)"
      " -> Tensor");
}

STABLE_TORCH_LIBRARY_IMPL(torchjoint, CPU, m) {
  m.impl("group_summaries", TORCH_BOX(&group_summaries));
}

}  // namespace torchjoint
