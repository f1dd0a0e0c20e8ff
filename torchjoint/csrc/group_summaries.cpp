// Mean and quantiles of the values in each group. The caller has sorted the values, once for many groupings. One pass in
// this order meets the values of each group in ascending order, so nothing is sorted here.
#include "array.h"
#include "common.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <vector>

namespace torchjoint {
namespace {

constexpr int32_t kNoGroup = -1, kWasMet = -2;

// Count and sum of the values of a group, and the progress of the pass in ascending order.
struct Group {
  double sum = 0;
  int32_t count = 0, met = 0;
  int32_t next_place = 0;  // of the next quantile among the values of the group
  int32_t next_quantile = 0;  // in ascending order of the quantiles
  float last = -std::numeric_limits<float>::infinity();  // value that the pass has met
};

class Quantiles {
 public:
  Quantiles(const float* shares, int64_t count) : share_(shares), ascending_(count) {
    std::iota(ascending_.begin(), ascending_.end(), 0);
    std::sort(ascending_.begin(), ascending_.end(), [&](int32_t a, int32_t b) { return share_[a] < share_[b]; });
  }

  int64_t count() const { return static_cast<int64_t>(ascending_.size()); }

  void find_place(Group& group) const {
    if (group.next_quantile == count()) {
      group.next_place = kNoGroup;
      return;
    }
    // The place of a quantile among n values is (n - 1) q in float32, rounded half to even.
    const float last = static_cast<float>(group.count - 1);
    const float place = std::nearbyint(last * share_[ascending_[group.next_quantile]]);
    group.next_place = static_cast<int32_t>(std::min(static_cast<int64_t>(place), int64_t{group.count} - 1));
  }

  // Handles the next value of the group: writes it for each quantile that is at its place.
  void take(Group& group, float value, double* out) const {
    const int32_t here = group.next_place;
    while (group.next_place == here) {
      out[ascending_[group.next_quantile++]] = value;
      find_place(group);
    }
  }

 private:
  const float* share_;
  std::vector<int32_t> ascending_;
};

Tensor group_summaries(const Tensor& values, const Tensor& order, const Tensor& group, int64_t num_groups,
                       const Tensor& quantiles) {
  const Tensor of_values = checked_array(values, ScalarType::Float, {-1}, "values");
  const int64_t num_values = of_values.size(0);
  check(num_values <= kMaxCount, "values: expected at most 2^31 - 1, got ", num_values);
  const Tensor ascending = checked_array(order, ScalarType::Int, {num_values}, "order");
  const Tensor of_groups = checked_array(group, ScalarType::Long, {num_values}, "group");
  const Tensor shares = checked_array(quantiles, ScalarType::Float, {-1}, "quantiles");
  check(num_groups >= 0 && num_groups <= kMaxCount, "num_groups: expected 0 to 2^31 - 1, got ", num_groups);
  check_shares(shares.const_data_ptr<float>(), shares.size(0), "quantiles");
  const Quantiles wanted(shares.const_data_ptr<float>(), shares.size(0));

  std::vector<Group> groups(num_groups);
  Array<int32_t> group_of(num_values);  // of the values that the pass has not met
  const float* const value = of_values.const_data_ptr<float>();
  const int64_t* const given = of_groups.const_data_ptr<int64_t>();
  for (int64_t i = 0; i < num_values; ++i) {
    group_of[i] = kNoGroup;
    if (given[i] == kNoGroup) continue;
    check_index(given[i], num_groups, "group", i);
    if (!std::isfinite(value[i])) continue;
    group_of[i] = static_cast<int32_t>(given[i]);
    groups[given[i]].sum += value[i];
    ++groups[given[i]].count;
  }

  const int64_t columns = 1 + wanted.count();
  Tensor result = torch::stable::new_empty(of_values, {num_groups, columns}, ScalarType::Double);
  double* const out = result.mutable_data_ptr<double>();
  std::fill_n(out, num_groups * columns, std::numeric_limits<double>::quiet_NaN());
  for (int64_t g = 0; g < num_groups; ++g) {
    if (groups[g].count == 0) continue;
    out[g * columns] = groups[g].sum / groups[g].count;
    wanted.find_place(groups[g]);
  }
  const int32_t* const place = ascending.const_data_ptr<int32_t>();
  for (int64_t r = 0; r < num_values; ++r) {
    const int64_t i = place[r];
    check_index(i, num_values, "order", r);
    const int32_t g = group_of[i];
    check(g != kWasMet, "order: expected a permutation, got ", i, " again at ", r);
    group_of[i] = kWasMet;
    if (g == kNoGroup) continue;
    Group& of = groups[g];
    check(value[i] >= of.last, "order: expected ascending values in each group, got a smaller one at ", r);
    of.last = value[i];
    if (of.met++ == of.next_place) wanted.take(of, value[i], out + g * columns + 1);
  }
  return result;
}

}  // namespace

STABLE_TORCH_LIBRARY_FRAGMENT(torchjoint, m) {
  m.def("group_summaries(Tensor values, Tensor order, Tensor group, int num_groups, Tensor quantiles) -> Tensor");
}

STABLE_TORCH_LIBRARY_IMPL(torchjoint, CPU, m) { m.impl("group_summaries", TORCH_BOX(&group_summaries)); }

}  // namespace torchjoint
