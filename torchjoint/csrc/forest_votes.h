// The votes of leaves for the pixels of a tile.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <vector>

#include "forest_tile.h"
#include "forest_trees.h"
#include "forest_walks.h"

namespace torchjoint {

// Rows and columns of pixels that the sites of a tile vote for.
constexpr int64_t kVotedRows = 2 * (kTileRows - kPatch) + kVotes, kVotedColumns = 2 * (kTileColumns - kPatch) + kVotes;

// Votes are counted in cells of 2 x 2 pixels, separately for each of the four pixels. So the counts of a site begin at
// the place of its first cell.
class TileVotes {
 public:
  TileVotes() : counts_(4 * kTilePlane) {
    for (int64_t pixel = 0; pixel < kVotes * kVotes; ++pixel) {
      place_[pixel] = static_cast<int32_t>(place(pixel % kVotes, pixel / kVotes));
    }
  }

  void add(const Forest& forest, const std::vector<Walk>& walks) {
    for (size_t i = 0; i < walks.size(); ++i) {
      fetch(forest, walks, i);
      uint32_t* const here = counts_.data() + walks[i].place;
      const int32_t leaf = ~walks[i].node, end = forest.start[leaf + 1];
      for (int32_t vote = forest.start[leaf]; vote < end; ++vote) ++here[place_[forest.pixel[vote]]];
    }
  }

  // Adds the counts to rows of pixels of this length, at most `columns` in a row; then sets them to 0.
  void move_to(uint32_t* pixels, int64_t row_length, int64_t columns) {
    columns = std::min(columns, kVotedColumns);
    for (int64_t row = 0; row < kVotedRows; ++row, pixels += row_length) {
      const uint32_t *const even = counts_.data() + place(row, 0), *const odd = counts_.data() + place(row, 1);
      for (int64_t column = 0; column + 1 < columns; column += 2) {
        pixels[column] += even[column / 2];
        pixels[column + 1] += odd[column / 2];
      }
    }
    std::fill(counts_.begin(), counts_.end(), 0);
  }

 private:
  // Leaves come in random order: the data of later leaves are prefetched while earlier leaves vote.
  static void fetch(const Forest& forest, const std::vector<Walk>& walks, size_t i) {
    constexpr size_t kAhead = 16;
    if (i + 2 * kAhead < walks.size()) __builtin_prefetch(&forest.start[~walks[i + 2 * kAhead].node]);
    if (i + kAhead < walks.size()) __builtin_prefetch(forest.pixel + forest.start[~walks[i + kAhead].node]);
  }

  static int64_t place(int64_t row, int64_t column) {
    return (row % 2 * 2 + column % 2) * kTilePlane + row / 2 * kTileColumns + column / 2;
  }

  std::vector<uint32_t> counts_;
  std::array<int32_t, kVotes * kVotes> place_;  // by column * 16 + row of a leaf's pixel
};

}  // namespace torchjoint
