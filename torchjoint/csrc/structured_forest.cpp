// Boundary strength of images by structured forests: at each site trees vote for the boundary pixels of a leaf.
#include "common.h"
#include "forest_channels.h"
#include "forest_tile.h"
#include "forest_trees.h"
#include "forest_votes.h"
#include "forest_walks.h"

namespace torchjoint {
namespace {

constexpr int64_t kMaxSide = 1 << 14;
// Votes of images of one size.
class Voting {
 public:
  Voting(const Forest& forest, int64_t height, int64_t width, int64_t step)
      : forest_(forest), height_(height), width_(width), step_(step), channels_(height, width),
        site_rows_(sites(channels_.rows)), site_columns_(sites(channels_.columns)),
        bands_((site_rows_ + tile_sites(kTileRows) - 1) / tile_sites(kTileRows)),
        counts_(bands_ * kVotedRows * row_length()), votes_(height * width) {}

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

  // The number of sites whose patches fit into so many cells of a tile.
  int64_t tile_sites(int64_t cells) const { return (cells - kPatch) / step_ + 1; }

  int64_t row_length() const { return 2 * channels_.columns; }

  // The votes of a band of tiles: [kVotedRows, row_length()]. Its last rows are the first rows of the next band.
  uint32_t* counts(int64_t band) { return counts_.data() + band * kVotedRows * row_length(); }

  void vote(int64_t band) {
    std::fill_n(counts(band), kVotedRows * row_length(), 0);
    ForestTile tile;
    ForestWalks walks;
    TileVotes votes;
    const int64_t top = band * tile_sites(kTileRows), rows = std::min(tile_sites(kTileRows), site_rows_ - top);
    for (int64_t left = 0; left < site_columns_; left += tile_sites(kTileColumns)) {
      tile.copy(channels_, step_ * top, step_ * left);
      const int64_t columns = std::min(tile_sites(kTileColumns), site_columns_ - left), pixel = 2 * step_ * left;
      for (int64_t tree = 0; tree < forest_.num_trees; ++tree) {
        votes.add(forest_, walks.to_leaves(forest_, tree, {rows, columns, step_, top + left}, tile.values()));
      }
      votes.move_to(counts(band) + pixel, row_length(), row_length() - pixel);
    }
  }

  void sum_bands(int64_t row, float weight) {
    std::vector<uint32_t> sums(row_length());
    const int64_t rows_apart = 2 * step_ * tile_sites(kTileRows);
    for (int64_t band = std::max<int64_t>(0, (row - kVotedRows) / rows_apart); band < bands_; ++band) {
      const int64_t own = row - band * rows_apart;
      if (own < 0) break;
      if (own >= kVotedRows) continue;
      const uint32_t* const count = counts(band) + own * row_length();
      for (size_t x = 0; x < sums.size(); ++x) sums[x] += count[x];
    }
    float* const votes = votes_.data() + row * width_;
    for (int64_t x = 0; x < width_; ++x) votes[x] = static_cast<float>(static_cast<int32_t>(sums[x])) * weight;
  }

  const Forest& forest_;
  const int64_t height_, width_, step_;
  ForestChannels channels_;
  const int64_t site_rows_, site_columns_, bands_;
  Array<uint32_t> counts_;
  Array<float> votes_;
};

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
  constexpr float kLargest = std::numeric_limits<float>::max();
  check_all(data, batch * 3 * height * width, -kLargest, kLargest, "images: expected finite numbers");
  // Each thread processes whole images; only a single image is divided between threads.
  in_parallel(batch, [&](int64_t begin, int64_t end) {
    Voting voting(forest, height, width, stride / 2);
    for (int64_t i = begin; i < end; ++i) voting.run(data + i * 3 * height * width, out + i * height * width);
  });
  return result;
}

}  // namespace

TORCHJOINT_OPERATOR(structured_forest,
                    "(Tensor images, Tensor children, Tensor features, Tensor thresholds, Tensor boundary_counts, "
                    "Tensor boundary_pixels, int trees_per_site, int stride=2) -> Tensor");

}  // namespace torchjoint
