// Boundary strength of images by structured forests: at each site trees vote for the boundary pixels of a leaf.
#include "common.h"
#include "forest_channels.h"
#include "forest_trees.h"

namespace torchjoint {
namespace {

constexpr int64_t kMaxSide = 1 << 14;
// Sites of a band of rows and a strip of columns go through a tree together: what they read stays in the cache.
constexpr int64_t kBandRows = 16, kStripColumns = 64;

// The two values, relative to a site's first cell, whose difference is a feature.
struct Ends {
  int32_t first, second;
};

std::vector<Ends> feature_ends(const ForestChannels& channels) {
  const auto at = [&](int64_t plane, int64_t row, int64_t column) {
    return static_cast<int32_t>(plane * channels.plane() + row * channels.columns + column);
  };
  std::vector<Ends> ends;
  ends.reserve(kFeatures);
  for (int64_t channel = 0; channel < kChannels; ++channel) {
    for (int64_t cell = 0; cell < kPatch * kPatch; ++cell) {
      ends.push_back({at(channel, cell % kPatch, cell / kPatch), at(2 * kChannels, 0, 0)});
    }
  }
  const auto grid_cell = [&](int64_t channel, int64_t cell) {
    return at(kChannels + channel, kGridCells[cell % kGrid], kGridCells[cell / kGrid]);
  };
  for (int64_t channel = 0; channel < kChannels; ++channel) {
    for (int64_t a = 0; a < kGrid * kGrid; ++a) {
      for (int64_t b = a + 1; b < kGrid * kGrid; ++b) ends.push_back({grid_cell(channel, a), grid_cell(channel, b)});
    }
  }
  return ends;
}

// A site, by the place of its first cell, on its way through a tree; at its end the node is the complement of a leaf.
struct Walk {
  int32_t node, place;
};

// Votes of images of one size.
class Voting {
 public:
  Voting(const Forest& forest, int64_t height, int64_t width, int64_t step)
      : forest_(forest), height_(height), width_(width), step_(step), channels_(height, width),
        ends_(feature_ends(channels_)), site_rows_(sites(channels_.rows)), site_columns_(sites(channels_.columns)),
        bands_((site_rows_ + kBandRows - 1) / kBandRows), band_cells_(step * (kBandRows - 1) + kVotes / 2),
        counts_(bands_ * 4 * band_cells_ * channels_.columns), votes_(height * width) {
    for (int64_t pixel = 0; pixel < kVotes * kVotes; ++pixel) {
      const int64_t row = pixel % kVotes, column = pixel / kVotes;
      pixel_[pixel] = static_cast<int32_t>(count_place(row, column % 2) + column / 2);
    }
  }

  void run(const float* image, float* out) {
    channels_.compute(image);
    in_parallel(bands_, [&](int64_t begin, int64_t end) {
      for (int64_t band = begin; band < end; ++band) vote(band);
    });
    const float weight = static_cast<float>(2.0 * 4 * step_ * step_ / (kVotes * kVotes) / forest_.per_site);
    in_blocks(height_, [&](int64_t first, int64_t last) {
      for (int64_t row = first; row < last; ++row) sum_bands(row, weight);
    });
    in_blocks(height_, [&](int64_t first, int64_t last) {
      triangle_filter<1>(votes_.data(), out, height_, width_, first, last);
    });
  }

 private:
  int64_t sites(int64_t cells) const { return std::max<int64_t>(0, (cells - kPatch + step_ - 1) / step_); }

  // Votes are counted in cells of 2 x 2 pixels, apart for each of the four pixels. So the counts of a site begin at the
  // place of its first cell. This is where those of a row of pixels begin, at even or odd columns.
  int64_t count_place(int64_t row, int64_t odd) const {
    return ((row % 2 * 2 + odd) * band_cells_ + row / 2) * channels_.columns;
  }

  uint32_t* counts(int64_t band) { return counts_.data() + band * 4 * band_cells_ * channels_.columns; }

  void vote(int64_t band) {
    uint32_t* const count = counts(band);
    std::fill_n(count, 4 * band_cells_ * channels_.columns, 0);
    const int64_t first = band * kBandRows, last = std::min(first + kBandRows, site_rows_);
    const int64_t first_place = step_ * first * channels_.columns;
    std::vector<Walk> walks;
    std::vector<uint8_t> votes(forest_.turns());
    for (int64_t tree = 0; tree < forest_.num_trees; ++tree) {
      for (int64_t turn = 0; turn < forest_.turns(); ++turn) votes[turn] = forest_.votes(tree, turn);
      for (int64_t left = 0; left < site_columns_; left += kStripColumns) {
        walks.clear();
        for (int64_t row = first; row < last; ++row) {
          int64_t turn = (row + left) % forest_.turns();
          for (int64_t column = left; column < std::min(left + kStripColumns, site_columns_); ++column) {
            const int64_t place = step_ * (row * channels_.columns + column);
            if (votes[turn]) walks.push_back({forest_.root[tree].node, static_cast<int32_t>(place)});
            if (++turn == forest_.turns()) turn = 0;
          }
        }
        find_leaves(tree, walks);
        for (const Walk& walk : walks) {
          uint32_t* const here = count + (walk.place - first_place);
          for (int32_t i = forest_.start[~walk.node]; i < forest_.start[~walk.node + 1]; ++i) {
            ++here[pixel_[forest_.pixel[i]]];
          }
        }
      }
    }
  }

  // All walks go down a level together: the next node and values of one are fetched while others are compared.
  void find_leaves(int64_t tree, std::vector<Walk>& walks) const {
    const Forest::Root root = forest_.root[tree];
    if (root.node < 0) return;
    const Node* const nodes = &forest_.nodes[root.first];
    const Ends* const ends = ends_.data();
    const float* const values = channels_.values();
    std::vector<Walk> at_leaf(walks.size() + 1);
    Walk *const going = walks.data(), *arrived = at_leaf.data();
    size_t num_going = walks.size();
    while (num_going > 0) {
      size_t stay = 0;
      for (size_t i = 0; i < num_going; ++i) {
        const Walk walk = going[i];
        const Node& node = nodes[walk.node];
        const Ends feature = ends[node.feature];
        const float* const patch = values + walk.place;
        // No branches: half of them would be predicted wrongly.
        const int32_t next = node.child[!(patch[feature.first] - patch[feature.second] < node.threshold)];
        __builtin_prefetch(nodes + next);
        *arrived = going[stay] = {next, walk.place};
        arrived += next < 0;
        stay += next >= 0;
      }
      num_going = stay;
    }
    std::copy(at_leaf.data(), arrived, walks.data());
  }

  void sum_bands(int64_t row, float weight) {
    std::vector<uint32_t> sums(2 * channels_.columns);
    const int64_t rows_apart = step_ * kBandRows;
    for (int64_t band = std::max<int64_t>(0, (row / 2 - band_cells_) / rows_apart); band < bands_; ++band) {
      const int64_t own = row - 2 * band * rows_apart;
      if (own < 0) break;
      if (own / 2 >= band_cells_) continue;
      const uint32_t *const even = counts(band) + count_place(own, 0), *const odd = counts(band) + count_place(own, 1);
      for (int64_t cell = 0; cell < channels_.columns; ++cell) {
        sums[2 * cell] += even[cell];
        sums[2 * cell + 1] += odd[cell];
      }
    }
    float* const votes = votes_.data() + row * width_;
    for (int64_t x = 0; x < width_; ++x) votes[x] = static_cast<float>(static_cast<int32_t>(sums[x])) * weight;
  }

  const Forest& forest_;
  const int64_t height_, width_, step_;
  ForestChannels channels_;
  const std::vector<Ends> ends_;
  const int64_t site_rows_, site_columns_, bands_, band_cells_;
  Array<uint32_t> counts_;
  Array<float> votes_;
  std::array<int32_t, kVotes * kVotes> pixel_;
};

void check_finite(const float* values, int64_t count) {
  int32_t bad = 0;
  for (int64_t i = 0; i < count; ++i) bad |= !(std::abs(values[i]) <= std::numeric_limits<float>::max());
  for (int64_t i = 0; bad && i < count; ++i) {
    check(std::isfinite(values[i]), "images: expected finite numbers, got ", values[i], " at ", i);
  }
}

Tensor structured_forest(const Tensor& images, const Tensor& children, const Tensor& features, const Tensor& thresholds,
                         const Tensor& boundary_counts, const Tensor& boundary_pixels, int64_t trees_per_site,
                         int64_t stride) {
  const Tensor image = checked_array(images, ScalarType::Float, {-1, 3, -1, -1}, "images");
  const int64_t batch = image.size(0), height = image.size(2), width = image.size(3);
  check(height <= kMaxSide && width <= kMaxSide, "images: expected at most ", kMaxSide, " pixels a side, got ", height,
        " x ", width);
  const Tensor child = checked_array(children, ScalarType::Int, {-1, -1}, "children");
  const int64_t trees = child.size(0), length = child.size(1);
  check(trees >= 1 && length >= 1 && trees * length < kMaxCount, "children: expected 1 to 2^31 - 2 nodes in all, got ",
        trees, " x ", length);
  const Tensor feature = checked_array(features, ScalarType::Int, {trees, length}, "features");
  const Tensor threshold = checked_array(thresholds, ScalarType::Float, {trees, length}, "thresholds");
  const Tensor counts = checked_array(boundary_counts, ScalarType::Int, {trees, length}, "boundary_counts");
  const Tensor pixels = checked_array(boundary_pixels, ScalarType::Byte, {-1}, "boundary_pixels");
  check(pixels.size(0) <= kMaxCount, "boundary_pixels: expected at most 2^31 - 1, got ", pixels.size(0));
  check(trees_per_site >= 1 && trees_per_site <= trees, "trees_per_site: expected 1 to ", trees, ", got ",
        trees_per_site);
  check(stride == 2 || stride == 4, "stride: expected 2 or 4, got ", stride);
  const Forest forest(child, feature, threshold, counts, pixels, trees_per_site);

  Tensor result = torch::stable::new_empty(image, {batch, height, width}, ScalarType::Float);
  if (batch * height * width == 0) return result;
  const float* const data = image.const_data_ptr<float>();
  float* const out = result.mutable_data_ptr<float>();
  check_finite(data, batch * 3 * height * width);
  // Each thread works on its own images; only a single image is divided between threads.
  in_parallel(batch, [&](int64_t begin, int64_t end) {
    Voting voting(forest, height, width, stride / 2);
    for (int64_t i = begin; i < end; ++i) voting.run(data + i * 3 * height * width, out + i * height * width);
  });
  return result;
}

}  // namespace

STABLE_TORCH_LIBRARY_FRAGMENT(torchjoint, m) {
  m.def(
      "structured_forest(Tensor images, Tensor children, Tensor features, Tensor thresholds, Tensor boundary_counts,"
      " Tensor boundary_pixels, int trees_per_site, int stride=2) -> Tensor");
}

STABLE_TORCH_LIBRARY_IMPL(torchjoint, CPU, m) {
  m.impl("structured_forest", TORCH_BOX(&structured_forest));
}

}  // namespace torchjoint
