"""Unites superpoints of neighbouring tiles.

Two tiles share the points of their buffers, and both have segmented them. A superpoint of one and a superpoint of the
other are the same if more than half of the shared points of each are in the other. So each superpoint has at most one
partner in each neighbouring tile, and a few shared points connect nothing. Only superpoints with points of their own
tile count: what a tile sees in its buffer alone is the neighbour's to say.

A shared point gets the label of the tile that owns it. The united superpoints are numbered by their first points. All
of this depends on the tiles' labels alone, not on the order in which the tiles were done.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from torchjoint.tiles.tile import TileLabels

Ints = npt.NDArray[np.int64]


def stitched_labels(
    num_tiles: int, neighbors: Sequence[tuple[int, int]], read: Callable[[int], TileLabels]
) -> list[Ints]:
    """The label in the whole cloud of each superpoint of each tile.

    Args:
        num_tiles: T.
        neighbors: pairs of tiles that share points.
        read: reads the labels of a tile; only two tiles are in memory at a time.

    Returns:
        T arrays [K_t] int64: for each superpoint of tile t its label in the cloud, 0, 1, 2, ... in the order of the
        first points; -1 if it has no points of the tile's own.
    """
    firsts = [_first_points(read(tile)) for tile in range(num_tiles)]
    offset = np.cumsum([0, *(len(first) for first in firsts)])
    first = np.concatenate(firsts)
    partners = [np.empty((0, 2), np.int64)]
    held, labels = -1, None
    for one, other in sorted(neighbors):
        if held != one or labels is None:
            held, labels = one, read(one)
        pairs = matching_superpoints(labels, read(other)) + offset[[one, other]]
        partners.append(pairs[(first[pairs] >= 0).all(1)])
    united = np.concatenate(partners)
    graph = coo_matrix((np.ones(len(united), bool), tuple(united.T)), shape=(len(first), len(first)))
    count, group = connected_components(graph, directed=False)
    there = first >= 0
    first_of_group = np.full(count, np.iinfo(np.int64).max)
    np.minimum.at(first_of_group, group[there], first[there])
    rank = np.empty(count, np.int64)
    rank[np.argsort(first_of_group, kind="stable")] = np.arange(count)
    label = np.where(there, rank[group], -1)
    return [label[start:end] for start, end in pairwise(offset)]


def matching_superpoints(one: TileLabels, other: TileLabels) -> Ints:
    """Pairs [P, 2] of superpoints of two tiles, more than half of whose shared points are in one another."""
    place = np.searchsorted(other.shared, one.shared)
    place[place == len(other.shared)] = 0
    both = other.shared[place] == one.shared if len(other.shared) else np.zeros(len(place), bool)
    first, second = one.shared_label[both].astype(np.int64), other.shared_label[place[both]].astype(np.int64)
    if not len(first):
        return np.empty((0, 2), np.int64)
    width = int(second.max()) + 1
    pair, count = np.unique(first * width + second, return_counts=True)
    pairs = np.stack([pair // width, pair % width], axis=1)
    larger = np.maximum(np.bincount(first)[pairs[:, 0]], np.bincount(second)[pairs[:, 1]])
    return pairs[2 * count > larger]


def _first_points(labels: TileLabels) -> Ints:
    """The first of the tile's own points in each superpoint [K]; -1: there is none."""
    highest = [array.max(initial=-1) for array in (labels.own_label, labels.shared_label)]
    first = np.full(int(max(highest)) + 1, -1, np.int64)
    found, place = np.unique(labels.own_label, return_index=True)
    first[found] = labels.own[place]
    return first
