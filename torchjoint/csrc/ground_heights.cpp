// The height of the ground at the points of a scan: profiles follow it outward, one in each column of azimuth.
#include "common.h"

#include <cmath>
#include <numbers>

namespace torchjoint {
namespace {

constexpr double kPi = std::numbers::pi;
constexpr int64_t kPointsAtOnce = 1 << 13, kColumnsAtOnce = 8;
constexpr int32_t kNone = -1;

struct Place {
  double distance, height;
};

// One profile: places by distance, the first of them at the sensor.
struct Profile {
  std::vector<Place> places;

  // Linear between two places, constant beyond the last.
  double at(double distance) const {
    const auto after = std::lower_bound(places.begin(), places.end(), distance,
                                        [](const Place& place, double value) { return place.distance < value; });
    const Place& below = after == places.begin() ? *after : *(after - 1);
    const Place& above = after == places.end() ? below : *after;
    const double way = above.distance - below.distance;
    const double share = way > 0 ? (distance - below.distance) / way : 0.0;
    return below.height + share * (above.height - below.height);
  }
};

struct Settings {
  int64_t num_columns;
  double row_height, slope, step, bump, near, blind;
  int64_t sides;
};

class Ground {
 public:
  Ground(const double* azimuth, const double* elevation, const double* distance, const double* height, const bool* used,
         int64_t count, const Settings& settings)
      : azimuth_(azimuth), distance_(distance), height_(height), settings_(settings), profiles_(settings.num_columns) {
    std::vector<int32_t> some;
    for (int64_t i = 0; i < count; ++i) {
      if (used[i]) some.push_back(static_cast<int32_t>(i));
    }
    check(!some.empty(), "used: expected at least one point");
    find_lowest(some, elevation);
    start_ = start_height(some);
    blind_ = blind_distance(some, elevation);
    for (int64_t column = 0; column < settings.num_columns; ++column) profiles_[column] = walk(column);
    std::vector<Profile> smooth(profiles_.size());
    parallel_for_each(settings.num_columns, kColumnsAtOnce, [&](int64_t i) { smooth[i] = without_bumps(i); });
    profiles_ = std::move(smooth);
  }

  // The ground's height at a point, between the profiles of two columns. They hold at the middles of the columns.
  double at(int64_t i) const {
    const double place = column_place(i) - 0.5, before = std::floor(place);
    const auto column = static_cast<int64_t>(before);
    const double left = profile(column).at(distance_[i]), right = profile(column + 1).at(distance_[i]);
    return left + (place - before) * (right - left);
  }

 private:
  double column_place(int64_t i) const {
    return (azimuth_[i] + kPi) / (2 * kPi) * static_cast<double>(settings_.num_columns);
  }

  int64_t column_of(int64_t i) const {
    return std::min(static_cast<int64_t>(column_place(i)), settings_.num_columns - 1);
  }

  const Profile& profile(int64_t column) const {
    const int64_t turned = column % settings_.num_columns;
    return profiles_[turned < 0 ? turned + settings_.num_columns : turned];
  }

  // The lowest point of each cell; of equally low ones, the first.
  void find_lowest(const std::vector<int32_t>& some, const double* elevation) {
    num_rows_ = static_cast<int64_t>(kPi / settings_.row_height) + 1;
    check(num_rows_ * settings_.num_columns <= kMaxCount, "row_height: expected fewer rows of cells, got ", num_rows_);
    lowest_.assign(num_rows_ * settings_.num_columns, kNone);
    for (const int32_t i : some) {
      const auto row = static_cast<int64_t>((elevation[i] + kPi / 2) / settings_.row_height);
      int32_t& lowest = lowest_[column_of(i) * num_rows_ + row];
      if (lowest == kNone || height_[i] < height_[lowest]) lowest = i;
    }
  }

  // The ground below the sensor: the median of the columns' lowest points near it, else of all.
  double start_height(const std::vector<int32_t>& some) const {
    double reach = std::numeric_limits<double>::infinity();
    for (const int32_t i : some) reach = std::min(reach, distance_[i]);
    reach = std::max(reach, settings_.near);
    constexpr double high = std::numeric_limits<double>::infinity();
    std::vector<double> lowest(settings_.num_columns, high);
    for (const int32_t i : some) {
      double& of_column = lowest[column_of(i)];
      if (distance_[i] <= reach) of_column = std::min(of_column, height_[i]);
    }
    std::erase(lowest, high);
    const auto middle = lowest.begin() + (static_cast<int64_t>(lowest.size()) - 1) / 2;
    std::nth_element(lowest.begin(), middle, lowest.end());
    return *middle;
  }

  double blind_distance(const std::vector<int32_t>& some, const double* elevation) const {
    std::vector<double> values;
    for (const int32_t i : some) values.push_back(elevation[i]);
    const auto low = values.begin() + static_cast<int64_t>(values.size()) / 200;  // a few come from below the ground
    std::nth_element(values.begin(), low, values.end());
    return start_ < 0 && *low < 0 ? settings_.blind * start_ / std::tan(*low) : 0.0;
  }

  Profile walk(int64_t column) const {
    Profile profile{{{0, start_}}};
    Place last{blind_, start_};
    for (int64_t row = 0; row < num_rows_; ++row) {
      const int32_t i = lowest_[column * num_rows_ + row];
      if (i == kNone) continue;
      const double way = distance_[i] - last.distance, step = std::abs(height_[i] - last.height);
      if (!(way > 0 && step <= settings_.step + settings_.slope * way)) continue;
      profile.places.push_back(last = {distance_[i], height_[i]});
    }
    return profile;
  }

  // The profile without the places that are higher than the median of the profiles beside it.
  Profile without_bumps(int64_t column) const {
    Profile smooth;
    std::vector<double> around(2 * settings_.sides + 1);
    for (const Place& place : profiles_[column].places) {
      for (int64_t side = -settings_.sides; side <= settings_.sides; ++side) {
        around[side + settings_.sides] = profile(column + side).at(place.distance);
      }
      std::nth_element(around.begin(), around.begin() + settings_.sides, around.end());
      if (place.height - around[settings_.sides] <= settings_.bump) smooth.places.push_back(place);
    }
    return smooth;
  }

  const double *azimuth_, *distance_, *height_;
  const Settings settings_;
  int64_t num_rows_ = 0;
  std::vector<int32_t> lowest_;
  double start_ = 0, blind_ = 0;
  std::vector<Profile> profiles_;
};

Tensor ground_heights(const Tensor& azimuth, const Tensor& elevation, const Tensor& distance, const Tensor& height,
                      const Tensor& used, int64_t num_columns, double row_height, double slope, double step,
                      double bump, double near, double blind, int64_t sides) {
  const Tensor turns = checked_array(azimuth, ScalarType::Double, {-1}, "azimuth");
  const int64_t count = turns.size(0);
  check(count <= kMaxCount, "azimuth: expected at most 2^31 - 1 points, got ", count);
  const Tensor rises = checked_array(elevation, ScalarType::Double, {count}, "elevation");
  const Tensor ways = checked_array(distance, ScalarType::Double, {count}, "distance");
  const Tensor heights = checked_array(height, ScalarType::Double, {count}, "height");
  const Tensor may = checked_array(used, ScalarType::Bool, {count}, "used");
  check(num_columns > 0 && num_columns <= kMaxCount, "num_columns: expected a number > 0, got ", num_columns);
  check(row_height >= 1e-6 && std::isfinite(row_height), "row_height: expected a finite number >= 1e-6, got ",
        row_height);
  // The first place of each profile is at the median of the others beside it: it stays, as bump is not negative.
  for (const auto& [name, value] : {std::pair{"slope", slope}, {"step", step}, {"bump", bump}, {"blind", blind}}) {
    check(value >= 0 && std::isfinite(value), name, ": expected a finite number >= 0, got ", value);
  }
  check(near >= 0, "near: expected a number >= 0, got ", near);
  check(sides >= 0 && sides <= num_columns, "sides: expected a number in [0, ", num_columns, "], got ", sides);
  const double *a = turns.const_data_ptr<double>(), *e = rises.const_data_ptr<double>();
  const double *d = ways.const_data_ptr<double>(), *h = heights.const_data_ptr<double>();
  for (int64_t i = 0; i < count; ++i) {
    check(std::abs(a[i]) <= kPi, "azimuth: expected numbers in [-pi, pi], got ", a[i], " at ", i);
    check(std::abs(e[i]) <= kPi / 2, "elevation: expected numbers in [-pi/2, pi/2], got ", e[i], " at ", i);
    check(d[i] >= 0 && std::isfinite(d[i]), "distance: expected finite numbers >= 0, got ", d[i], " at ", i);
    check(std::isfinite(h[i]), "height: expected finite numbers, got ", h[i], " at ", i);
  }
  const Ground ground(a, e, d, h, may.const_data_ptr<bool>(), count,
                      {num_columns, row_height, slope, step, bump, near, blind, sides});
  Tensor found = torch::stable::new_empty(turns, {count}, ScalarType::Double);
  double* const at = found.mutable_data_ptr<double>();
  parallel_for_each(count, kPointsAtOnce, [&](int64_t i) { at[i] = ground.at(i); });
  return found;
}

}  // namespace

TORCHJOINT_OPERATOR(ground_heights,
                    "(Tensor azimuth, Tensor elevation, Tensor distance, Tensor height, Tensor used, int "
                    "num_columns, float row_height, float slope, float step, float bump, float near, float blind, "
                    "int sides) -> Tensor");

}  // namespace torchjoint
