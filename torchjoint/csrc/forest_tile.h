// The channels around some sites, copied to one small block of memory.
//
// So all values that the walks of these sites read are in the cache. A tile has the same size in every image, so 16 bits
// can store the offset of a value.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <limits>
#include <vector>

#include "forest_channels.h"

namespace torchjoint {

// Side of a patch, in cells of the channels; a cell is two pixels wide.
constexpr int64_t kPatch = 16;
// Features: single values (channel, column, row), then differences of a channel between two cells of a 5 x 5 grid.
constexpr int64_t kGrid = 5, kPairs = kGrid * kGrid * (kGrid * kGrid - 1) / 2;
constexpr int64_t kSingle = kChannels * kPatch * kPatch, kFeatures = kSingle + kChannels * kPairs;
constexpr std::array<int64_t, kGrid> kGridCells{1, 4, 8, 11, 14};

// 16 x 63 sites and the patches around them.
constexpr int64_t kTileRows = 31, kTileColumns = 78, kTilePlane = kTileRows * kTileColumns;
// The channels smoothed in two ways, and zeros, so that a single value is also a difference.
constexpr int64_t kZeros = 2 * kChannels, kTileSize = (kZeros + 1) * kTilePlane;

// The offsets from a site's first cell to the two values whose difference is a feature.
struct Feature {
  uint16_t first, second;
};
static_assert(kTileSize <= std::numeric_limits<uint16_t>::max());

inline const std::array<Feature, kFeatures>& tile_features() {
  static const std::array<Feature, kFeatures> features = [] {
    std::array<Feature, kFeatures> found;
    Feature* next = found.data();
    const auto at = [](int64_t plane, int64_t row, int64_t column) {
      return static_cast<uint16_t>(plane * kTilePlane + row * kTileColumns + column);
    };
    for (int64_t channel = 0; channel < kChannels; ++channel) {
      for (int64_t cell = 0; cell < kPatch * kPatch; ++cell) {
        *next++ = {at(channel, cell % kPatch, cell / kPatch), at(kZeros, 0, 0)};
      }
    }
    const auto grid_cell = [&](int64_t channel, int64_t cell) {
      return at(kChannels + channel, kGridCells[cell % kGrid], kGridCells[cell / kGrid]);
    };
    for (int64_t channel = 0; channel < kChannels; ++channel) {
      for (int64_t a = 0; a < kGrid * kGrid; ++a) {
        for (int64_t b = a + 1; b < kGrid * kGrid; ++b) *next++ = {grid_cell(channel, a), grid_cell(channel, b)};
      }
    }
    return found;
  }();
  return features;
}

class ForestTile {
 public:
  ForestTile() : values_(kTileSize) {}

  // Copies the channels from this cell on, up to the end of the tile or of the channels.
  void copy(const ForestChannels& channels, int64_t first_row, int64_t first_column) {
    const int64_t rows = std::min(kTileRows, channels.rows - first_row);
    const int64_t columns = std::min(kTileColumns, channels.columns - first_column);
    for (int64_t plane = 0; plane < kZeros; ++plane) {
      const float* from = channels.values() + plane * channels.plane() + first_row * channels.columns + first_column;
      float* to = values_.data() + plane * kTilePlane;
      for (int64_t row = 0; row < rows; ++row, from += channels.columns, to += kTileColumns) {
        std::copy_n(from, columns, to);
      }
    }
  }

  // [kZeros + 1, kTileRows, kTileColumns]
  const float* values() const { return values_.data(); }

 private:
  std::vector<float> values_;
};

}  // namespace torchjoint
