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

// A site on its way through a tree.
struct Walk {
  int32_t node, place, site;
};

// Votes of images of one size.
class Voting {
 public:
  Voting(const Forest& forest, int64_t height, int64_t width, int64_t step)
      : forest_(forest), height_(height), width_(width), step_(step), channels_(height, width),
        ends_(feature_ends(channels_)), site_rows_(sites(channels_.rows)), site_columns_(sites(channels_.columns)),
        bands_((site_rows_ + kBandRows - 1) / kBandRows), band_height_(2 * step * (kBandRows - 1) + kVotes),
        counts_(bands_ * band_height_ * width), votes_(height * width) {
    for (int64_t pixel = 0; pixel < kVotes * kVotes; ++pixel) {
      pixel_[pixel] = static_cast<int32_t>(pixel % kVotes * width + pixel / kVotes);
    }
  }

  void run(const float* image, float* out) {
    channels_.compute(image);
    torch::stable::parallel_for(0, bands_, 1, [&](int64_t begin, int64_t end) {
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

  void vote(int64_t band) {
    uint32_t* const counts = counts_.data() + band * band_height_ * width_;
    std::fill_n(counts, band_height_ * width_, 0);
    const int64_t first = band * kBandRows, last = std::min(first + kBandRows, site_rows_);
    std::vector<Walk> walks;
    std::vector<int32_t> leaf, pixel;
    std::vector<uint8_t> votes(forest_.turns());
    for (int64_t tree = 0; tree < forest_.num_trees; ++tree) {
      for (int64_t turn = 0; turn < forest_.turns(); ++turn) votes[turn] = forest_.votes(tree, turn);
      for (int64_t left = 0; left < site_columns_; left += kStripColumns) {
        walks.clear();
        pixel.clear();
        for (int64_t row = first; row < last; ++row) {
          int64_t turn = (row + left) % forest_.turns();
          for (int64_t column = left; column < std::min(left + kStripColumns, site_columns_); ++column) {
            const bool asked = votes[turn];
            if (++turn == forest_.turns()) turn = 0;
            if (!asked) continue;
            const int64_t place = step_ * (row * channels_.columns + column);
            walks.push_back({forest_.root[tree].node, static_cast<int32_t>(place), static_cast<int32_t>(pixel.size())});
            pixel.push_back(static_cast<int32_t>(2 * step_ * ((row - first) * width_ + column)));
          }
        }
        leaf.resize(walks.size());
        find_leaves(tree, walks, leaf.data());
        for (size_t site = 0; site < pixel.size(); ++site) {
          for (int32_t i = forest_.start[leaf[site]]; i < forest_.start[leaf[site] + 1]; ++i) {
            ++counts[pixel[site] + pixel_[forest_.pixel[i]]];
          }
        }
      }
    }
  }

  // All walks go down a level together: the next node and values of one are fetched while others are compared.
  void find_leaves(int64_t tree, std::vector<Walk>& walks, int32_t* leaf) const {
    const Forest::Root root = forest_.root[tree];
    if (root.node < 0) {
      std::fill_n(leaf, walks.size(), ~root.node);
      return;
    }
    const Node* const nodes = &forest_.nodes[root.first];
    const Ends* const ends = ends_.data();
    Walk* const walk_of = walks.data();
    const float* const values = channels_.values();
    size_t going = walks.size();
    while (going > 0) {
      size_t stay = 0;
      for (size_t i = 0; i < going; ++i) {
        const Walk walk = walk_of[i];
        const Node& node = nodes[walk.node];
        const Ends feature = ends[node.feature];
        const float* const patch = values + walk.place;
        // No branch: half of them would be predicted wrongly.
        const int32_t next = node.child[!(patch[feature.first] - patch[feature.second] < node.threshold)];
        leaf[walk.site] = ~next;  // of an inner node it is written again
        __builtin_prefetch(nodes + next);
        walk_of[stay] = {next, walk.place, walk.site};
        stay += next >= 0;
      }
      going = stay;
    }
  }

  void sum_bands(int64_t row, float weight) {
    const int64_t rows_apart = 2 * step_ * kBandRows;
    std::vector<uint32_t> sums(width_);
    for (int64_t band = std::max<int64_t>(0, (row - band_height_) / rows_apart); band < bands_; ++band) {
      const int64_t own = row - band * rows_apart;
      if (own < 0) break;
      if (own >= band_height_) continue;
      const uint32_t* const counts = counts_.data() + (band * band_height_ + own) * width_;
      for (int64_t x = 0; x < width_; ++x) sums[x] += counts[x];
    }
    float* const votes = votes_.data() + row * width_;
    for (int64_t x = 0; x < width_; ++x) votes[x] = static_cast<float>(static_cast<int32_t>(sums[x])) * weight;
  }

  const Forest& forest_;
  const int64_t height_, width_, step_;
  ForestChannels channels_;
  const std::vector<Ends> ends_;
  const int64_t site_rows_, site_columns_, bands_, band_height_;
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
  torch::stable::parallel_for(0, batch, 1, [&](int64_t begin, int64_t end) {
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
