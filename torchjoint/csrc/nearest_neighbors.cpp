// The nearest neighbours of every point of a cloud. The points of a leaf of a k-d tree have nearly the same neighbours, so
// the tree is searched once per leaf, for all candidates of its points; each point then chooses among these candidates.
#include "neighbor_candidates.h"

#include <atomic>
#include <cmath>
#include <optional>
#include <type_traits>

namespace torchjoint {
namespace {

constexpr int64_t kLeavesPerBlock = 64;
// If a leaf has more candidates than kFewCandidates, and than kMostCandidates per neighbour, its points are far apart.
constexpr size_t kFewCandidates = 8192, kMostCandidates = 32;
constexpr size_t kNoLimit = std::numeric_limits<size_t>::max();
// Sorting by rank needs no branches, but quadratic time, so it is only used up to this number.
constexpr size_t kMostRanked = 96;
// Factor for bounds, larger than their rounding errors.
constexpr double kSlack = 1 + 1e-9;
constexpr double kInfinity = std::numeric_limits<double>::infinity();
// Points are only closer together than sqrt(rounded_up(0)) if their coordinates are below this limit. All of a clump of
// such points would be candidates of each of them. So smaller coordinates in float32 are searched in float64, in which
// no difference of them is too small to be squared; in float64 they count as 0.
template <typename Value>
constexpr double kTiny = std::is_same_v<Value, float> ? 1e-11 : 1e-136;

struct Neighbor {
  double squared_distance;
  int32_t index;
};

// The order of neighbours: by distance; of equally far points, the one with the smaller number comes first.
bool operator<(const Neighbor& a, const Neighbor& b) {
  return a.squared_distance != b.squared_distance ? a.squared_distance < b.squared_distance : a.index < b.index;
}

template <typename Value>
double squared_distance(const Value* a, const Value* b) {
  const double x = double{a[0]} - b[0], y = double{a[1]} - b[1], z = double{a[2]} - b[2];
  return (x * x + y * y) + z * z;
}

template <typename Value>
class Search {
 public:
  Search(const PointTree<Value>& tree, const double* limits, int64_t count, int64_t num_distances, int32_t* indices,
         Value* distances)
      : tree_(tree), limits_(limits), count_(count), num_distances_(num_distances), wanted_(count + 1),
        indices_(indices), distances_(distances) {}

  void search_leaf(int64_t leaf) {
    const int64_t size = tree_.num_points(leaf, leaf + 1);
    if (search_together(leaf, 0, size)) return;
    for (int64_t i = 0; i < size; ++i) search_together(leaf, i, i + 1);
  }

 private:
  struct Point {
    Value at[3];
    int32_t index;
    double radius;  // distance from the centre of the points that are searched together
    double limit;  // largest distance of its neighbours
  };

  // Searches the neighbours of some points of a leaf. If the points are too far apart, it returns false and does nothing.
  bool search_together(int64_t leaf, int64_t first, int64_t last) {
    Value center[3];
    const auto [radius, limit] = take(tree_.leaf(leaf), first, last, center);
    // At least `wanted_` points are within `reach` of the centre. So a point at distance r from the centre has as many
    // within reach + r, and all of these are within reach + 2 r of the centre. The first reach is a rough estimate. All
    // that is within the points' limits is within limit + radius.
    double reach = reach_around(leaf, center);
    if (reach < limit + radius) {
      gather(center, squared(reach), kNoLimit);
      candidates_.measure(center);
      reach = wanted_within();
    }
    const bool is_one_place = radius == 0;
    const double all = std::min(reach + 2 * radius, limit + radius);
    if (!gather(center, squared(all), is_one_place ? kNoLimit : most_together())) return false;
    candidates_.measure(center);
    candidates_.keep_up_to(rounded_up<Value>(squared(all)));
    if (is_one_place) keep_lowest_copies(center);
    last_ = rounded_up<Value>(squared(reach));
    for (int64_t i = 0; i < last - first; ++i) {
      choose(together_[i], squared(std::min(reach + together_[i].radius, together_[i].limit)));
    }
    return true;
  }

  // The number of candidates beyond which the points of a leaf are searched one by one.
  size_t most_together() const { return std::max(kFewCandidates, kMostCandidates * wanted_); }

  // Takes points [first, last) of a leaf, and finds the centre of their box, their largest distance from it, and their
  // largest limit.
  std::pair<double, double> take(const typename PointTree<Value>::Leaf& leaf, int64_t first, int64_t last,
                                 Value* center) {
    for (int d = 0; d < 3; ++d) {
      const auto [low, high] = std::minmax_element(leaf.at[d] + first, leaf.at[d] + last);
      center[d] = *low == *high ? *low : *low / 2 + *high / 2;
    }
    double radius = 0, limit = 0;
    for (int64_t i = first; i < last; ++i) {
      Point& point =
          together_[i - first] = {{leaf.at[0][i], leaf.at[1][i], leaf.at[2][i]}, leaf.index[i], 0, kInfinity};
      if (limits_ != nullptr) point.limit = limits_[point.index];
      point.radius = std::sqrt(squared_distance(center, point.at));
      radius = std::max(radius, point.radius), limit = std::max(limit, point.limit);
    }
    return {radius, limit};
  }

  static double squared(double distance) { return distance * distance * kSlack; }

  // A distance from the centre within which there are at least `wanted_` points.
  double reach_around(int64_t leaf, const Value* center) {
    const auto [first, last] = tree_.leaves_around(leaf, wanted_);
    candidates_.size = 0;
    for (int64_t i = first; i < last; ++i) candidates_.add(tree_.leaf(i), tree_.num_points(i, i + 1));
    candidates_.measure(center);
    return wanted_within();
  }

  double wanted_within() const {
    const Value* distance = candidates_.distance.data();
    const Value farthest = *std::max_element(distance, distance + candidates_.size);
    const Value first = farthest * (static_cast<Value>(wanted_ + 1) / static_cast<Value>(candidates_.size + 1));
    return std::sqrt(double{rounded_up<Value>(threshold(distance, candidates_.size, wanted_, farthest, first))});
  }

  // Gathers the points of all leaves that are at most sqrt(limit) from a place; false if there are more than `most`.
  bool gather(const Value* place, double limit, size_t most) {
    tree_.leaves_near(place, rounded_up<Value>(limit), leaves_);
    if (leaves_.size() * PointTree<Value>::kLeafSize > most) return false;
    candidates_.size = 0;
    for (const int32_t leaf : leaves_) candidates_.add(tree_.leaf(leaf), tree_.num_points(leaf, leaf + 1));
    return true;
  }

  // If a point has more copies than are wanted, keeps those with the lowest numbers.
  void keep_lowest_copies(const Value* place) {
    near_.clear();
    for (size_t i = 0; i < candidates_.size; ++i) {
      const Value at[] = {candidates_.at[0][i], candidates_.at[1][i], candidates_.at[2][i]};
      if (std::equal(at, at + 3, place)) near_.push_back(candidates_.index[i]);
    }
    if (near_.size() <= wanted_) return;
    std::nth_element(near_.begin(), near_.begin() + wanted_, near_.end());
    candidates_.size = wanted_;
    std::copy_n(near_.begin(), wanted_, candidates_.index.begin());
    for (int d = 0; d < 3; ++d) std::fill_n(candidates_.at[d].begin(), wanted_, place[d]);
  }

  // Writes the neighbours of a point; they are within sqrt(limit). All distances are first computed in Value, which is
  // fast; those of possible neighbours are computed again in double.
  void choose(const Point& point, double limit) {
    candidates_.measure(point.at);
    const Value* distance = candidates_.distance.data();
    const Value high = rounded_up<Value>(limit);
    last_ = threshold(distance, candidates_.size, wanted_, high, std::min(last_, high / 2));
    sort(point, keep_near(rounded_up<Value>(last_)));
    write(point);
  }

  // Keeps the candidates up to a distance, and their distances, in near_ and near_distance_; returns how many.
  size_t keep_near(Value limit) {
    near_.resize(candidates_.size);
    near_distance_.resize(candidates_.size);
    const Value* distance = candidates_.distance.data();
    size_t kept = 0;
    for_each_up_to(distance, candidates_.size, limit, [&](size_t i) {
      near_distance_[kept] = distance[i];
      near_[kept++] = static_cast<int32_t>(i);
    });
    return kept;
  }

  // Sorts the near candidates: first by their rounded distances, and then by the distances themselves.
  void sort(const Point& point, size_t size) {
    order(size);
    sorted_.resize(size);
    for (size_t i = 0; i < size; ++i) {
      const int32_t candidate = order_[i];
      const Value at[] = {candidates_.at[0][candidate], candidates_.at[1][candidate], candidates_.at[2][candidate]};
      sorted_[i] = {squared_distance(at, point.at), candidates_.index[candidate]};
    }
    if (size > kMostRanked) return std::sort(sorted_.begin(), sorted_.end());
    for (size_t i = 1; i < size; ++i) {  // nearly sorted already
      const Neighbor moved = sorted_[i];
      size_t to = i;
      for (; to > 0 && moved < sorted_[to - 1]; --to) sorted_[to] = sorted_[to - 1];
      sorted_[to] = moved;
    }
  }

  // Sorts the near candidates by their rounded distances, unless there are too many.
  void order(size_t size) {
    order_.resize(size);
    if (size > kMostRanked) {
      std::copy(near_.begin(), near_.begin() + size, order_.begin());
      return;
    }
    const Value* distance = near_distance_.data();
    uint8_t taken[kMostRanked] = {};
    for (size_t i = 0; i < size; ++i) {
      const Value own = distance[i];
      int32_t rank = 0;
      for (size_t j = 0; j < size; ++j) rank += distance[j] < own;
      order_[rank + taken[rank]++] = near_[i];
    }
  }

  // Writes the neighbours within the limit of a point. Where there are too few, the point itself takes their place.
  void write(const Point& point) {
    int32_t* indices = indices_ + point.index * count_;
    Value* distances = distances_ + point.index * num_distances_;
    std::fill_n(indices, count_, point.index);
    std::fill_n(distances, num_distances_, std::numeric_limits<Value>::infinity());
    int64_t written = 0;
    for (const Neighbor& near : sorted_) {
      if (written == count_ || near.squared_distance > point.limit * point.limit) return;
      if (near.index == point.index) continue;
      if (written < num_distances_) distances[written] = static_cast<Value>(std::sqrt(near.squared_distance));
      indices[written++] = near.index;
    }
  }

  const PointTree<Value>& tree_;
  const double* const limits_;  // none: no limits
  const int64_t count_, num_distances_;
  const size_t wanted_;  // neighbours and the point itself
  int32_t* indices_;
  Value* distances_;
  Point together_[PointTree<Value>::kLeafSize];
  Candidates<Value> candidates_;
  Value last_ = 0;  // squared distance of the previous point's last neighbour: a first guess for the next point
  std::vector<Value> near_distance_;
  std::vector<int32_t> leaves_, near_, order_;
  std::vector<Neighbor> sorted_;
};

template <typename Value>
void search_all(const Value* points, const double* limits, int64_t num_points, int64_t count, int64_t num_distances,
                int32_t* indices, Value* distances) {
  const PointTree<Value> tree(points, num_points);
  const int64_t blocks = (tree.num_leaves() + kLeavesPerBlock - 1) / kLeavesPerBlock;
  std::atomic<int64_t> next = 0;  // blocks take different times, so a free thread takes the next block
  torch::stable::parallel_for(0, blocks, 1, [&](int64_t, int64_t) {
    Search<Value> search(tree, limits, count, num_distances, indices, distances);
    for (int64_t block = next++; block < blocks; block = next++) {
      const int64_t first = block * kLeavesPerBlock, last = std::min(first + kLeavesPerBlock, tree.num_leaves());
      run_fastest([&] {
        for (int64_t leaf = first; leaf < last; ++leaf) search.search_leaf(leaf);
      });
    }
  });
}

template <typename Value>
bool is_tiny(Value value) {
  return value != 0 && std::abs(value) < kTiny<Value>;
}

// The values of a tensor in another dtype.
template <typename To, typename From>
Tensor converted(const Tensor& tensor, ScalarType dtype) {
  Tensor values = torch::stable::new_empty(tensor, {tensor.size(0), tensor.size(1)}, dtype);
  std::copy_n(tensor.const_data_ptr<From>(), tensor.numel(), values.mutable_data_ptr<To>());
  return values;
}

std::tuple<Tensor, Tensor> nearest_neighbors(const Tensor& points, int64_t count, int64_t num_distances,
                                             const std::optional<Tensor>& limits) {
  check(points.is_cpu(), "points: expected a CPU tensor");
  check(is_floating(points), "points: expected dtype torch.float32 or torch.float64");
  check(points.dim() == 2 && points.size(1) == 3, "points: expected shape [N, 3]");
  const int64_t num_points = points.size(0);
  check(num_points <= kMaxCount, "points: expected at most 2^31 - 1 points, got ", num_points);
  check(count >= 0, "count: expected a number >= 0, got ", count);
  check(num_distances >= 0, "num_distances: expected a number >= 0, got ", num_distances);
  Tensor coordinates = torch::stable::contiguous(points);
  std::vector<double> limit;
  if (limits) {
    const Tensor given = checked_array(*limits, ScalarType::Double, {num_points}, "limits");
    limit.assign(given.const_data_ptr<double>(), given.const_data_ptr<double>() + num_points);
    for (int64_t i = 0; i < num_points; ++i) {
      check(limit[i] >= 0, "limits: expected numbers >= 0, got ", limit[i], " at ", i);
    }
  }
  bool has_tiny = false;
  with_values(coordinates, [&]<typename Value>(const Value* values) {
    for (int64_t i = 0; i < 3 * num_points; ++i) {
      check(std::isfinite(values[i]), "points: expected finite coordinates, got ", values[i], " in row ", i / 3);
      has_tiny |= is_tiny(values[i]);
    }
  });
  if (has_tiny && points.scalar_type() == ScalarType::Float) {
    const auto [indices, distances] =
        nearest_neighbors(converted<double, float>(coordinates, ScalarType::Double), count, num_distances, limits);
    return {indices, converted<float, double>(distances, ScalarType::Float)};
  }
  if (has_tiny) {  // a copy without coordinates whose squares vanish
    coordinates = converted<double, double>(coordinates, ScalarType::Double);
    double* const at = coordinates.mutable_data_ptr<double>();
    std::replace_if(at, at + coordinates.numel(), is_tiny<double>, 0.0);
  }
  count = std::min(count, std::max<int64_t>(num_points - 1, 0));
  num_distances = std::min(num_distances, count);
  Tensor indices = torch::stable::new_empty(coordinates, {num_points, count}, ScalarType::Int);
  Tensor distances = torch::stable::new_empty(coordinates, {num_points, num_distances}, points.scalar_type());
  with_values(coordinates, [&]<typename Value>(const Value* values) {
    if (count == 0) return;
    use_huge_pages(indices.mutable_data_ptr<int32_t>(), num_points * count * sizeof(int32_t));
    use_huge_pages(distances.mutable_data_ptr<Value>(), num_points * num_distances * sizeof(Value));
    search_all(values, limits ? limit.data() : nullptr, num_points, count, num_distances,
               indices.mutable_data_ptr<int32_t>(), distances.mutable_data_ptr<Value>());
  });
  return {indices, distances};
}

}  // namespace

TORCHJOINT_OPERATOR(nearest_neighbors,
                    "(Tensor points, int count, int num_distances, Tensor? limits) -> (Tensor, Tensor)");

}  // namespace torchjoint
