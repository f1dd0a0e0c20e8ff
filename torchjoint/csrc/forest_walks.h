// Walks of the sites of a tile through a tree of a structured forest, from the root to a leaf.
#pragma once

#include <cstdint>
#include <vector>

#include "forest_tile.h"
#include "forest_trees.h"

namespace torchjoint {

// Sites of a tile, `step` cells apart. `turn` is row + column of the first site in the whole image.
struct TileSites {
  int64_t rows, columns, step, turn;
};

// A site; `place` is that of its first cell in the tile. At the end of its walk, the node is the complement of a leaf.
struct Walk {
  int32_t node, place;
};

class ForestWalks {
 public:
  // The walks of those sites at which the tree votes, in the order in which they reach a leaf.
  const std::vector<Walk>& to_leaves(const Forest& forest, int64_t tree, const TileSites& sites, const float* values) {
    start(forest, tree, sites);
    if (forest.root[tree].node >= 0) find_leaves(&forest.nodes[forest.root[tree].first], values);
    return walks_;
  }

 private:
  void start(const Forest& forest, int64_t tree, const TileSites& sites) {
    votes_.clear();
    for (int64_t i = 0; i < sites.rows + sites.columns; ++i) votes_.push_back(forest.votes(tree, sites.turn + i));
    walks_.clear();
    for (int64_t row = 0; row < sites.rows; ++row) {
      for (int64_t column = 0; column < sites.columns; ++column) {
        const int64_t place = sites.step * (row * kTileColumns + column);
        if (votes_[row + column]) walks_.push_back({forest.root[tree].node, static_cast<int32_t>(place)});
      }
    }
  }

  // All walks go down one level at a time: the next node of a walk is prefetched while other walks are compared.
  void find_leaves(const Node* nodes, const float* values) {
    arrived_.resize(walks_.size() + 1);
    Walk *const going = walks_.data(), *arrived = arrived_.data();
    size_t num_going = walks_.size();
    while (num_going > 0) {
      size_t stay = 0;
      for (size_t i = 0; i < num_going; ++i) {
        const Walk walk = going[i];
        const Node& node = nodes[walk.node];
        const float* const patch = values + walk.place;
        // No branches: half of the predictions would be wrong.
        const int32_t next = node.child[!(patch[node.feature.first] - patch[node.feature.second] < node.threshold)];
        __builtin_prefetch(nodes + next);
        *arrived = going[stay] = {next, walk.place};
        arrived += next < 0;
        stay += next >= 0;
      }
      num_going = stay;
    }
    std::copy(arrived_.data(), arrived, walks_.data());
  }

  std::vector<Walk> walks_, arrived_;
  std::vector<uint8_t> votes_;  // by row + column of a site in the tile
};

}  // namespace torchjoint
