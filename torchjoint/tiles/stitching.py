"""Unites superpoints of neighbouring tiles.

Two tiles share the points of their buffers, and both have segmented them. A superpoint of one and a superpoint of the
other are the same if more than half of the shared points of each are in the other. So each superpoint has at most one
partner in each neighbouring tile, and a few shared points connect nothing. Only superpoints with points of their own
tile count: what a tile sees in its buffer alone is the neighbour's to say.

A shared point gets the label of the tile that owns it, except in small superpoints on the edge of two tiles: see
:mod:`~torchjoint.tiles.crossings`. The united superpoints are numbered by their first points. All of this depends on
the tiles' labels alone, not on the order in which the tiles were done.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from torchjoint.tiles.crossings import changes_at_crossings
from torchjoint.tiles.tile import TileLabels

Ints = npt.NDArray[np.int64]


class Stitched(NamedTuple):
    """The labels of a cloud: 0, 1, 2, ... in the order of their first points."""

    of_tiles: list[Ints]  #: [K_t] for each tile: the label of each of its superpoints; -1: nothing has it
    changed: Ints  #: [C] points that have another label than their tile says, ascending
    changed_label: Ints  #: [C]


def stitched_labels(
    num_tiles: int, neighbors: Sequence[tuple[int, int]], read: Callable[[int], TileLabels]
) -> Stitched:
    """The labels of the whole cloud.

    Args:
        num_tiles: T.
        neighbors: pairs of tiles that share points.
        read: reads the labels of a tile; only two tiles are in memory at a time.
    """
    firsts = [_first_points(read(tile)) for tile in range(num_tiles)]
    offset = np.cumsum([0, *(len(first) for first in firsts)])
    has_points = np.concatenate(firsts) >= 0
    partners, points, takers = [np.empty((0, 2), np.int64)], [np.empty(0, np.int64)], [np.empty(0, np.int64)]
    held, labels = -1, None
    for one, other in sorted(neighbors):
        if held != one or labels is None:
            held, labels = one, read(one)
        neighbor = read(other)
        matching = matching_superpoints(labels, neighbor)
        pairs = matching + offset[[one, other]]
        partners.append(pairs[has_points[pairs].all(1)])
        changes = changes_at_crossings(labels, neighbor, matching)
        taker = changes.superpoint + offset[np.where(changes.tile == 0, one, other)]
        points.append(changes.point[has_points[taker]])
        takers.append(taker[has_points[taker]])
    changed, place = np.unique(np.concatenate(points), return_index=True)  # the first pair of tiles decides
    taker = np.concatenate(takers)[place]
    if len(changed):
        firsts = [_first_points(read(tile), changed) for tile in range(num_tiles)]
    rank = _ranks(np.concatenate(partners), np.concatenate(firsts), changed, taker)
    return Stitched([rank[start:end] for start, end in pairwise(offset)], changed, rank[taker])


def _ranks(united: Ints, first: Ints, changed: Ints, taker: Ints) -> Ints:
    """The label of each superpoint of all tiles, by the first points of the united ones; -1: it has no points."""
    graph = coo_matrix((np.ones(len(united), bool), tuple(united.T)), shape=(len(first), len(first)))
    count, group = connected_components(graph, directed=False)
    none = np.iinfo(np.int64).max
    first_of_group = np.full(count, none)
    np.minimum.at(first_of_group, group[first >= 0], first[first >= 0])
    np.minimum.at(first_of_group, group[taker], changed)
    rank = np.empty(count, np.int64)
    rank[np.argsort(first_of_group, kind="stable")] = np.arange(count)
    rank[first_of_group == none] = -1
    labels: Ints = rank[group]
    return labels


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


def _first_points(labels: TileLabels, without: Ints | None = None) -> Ints:
    """The first of the tile's own points in each superpoint [K], without some points; -1: there is none."""
    highest = [array.max(initial=-1) for array in (labels.own_label, labels.shared_label)]
    first = np.full(int(max(highest)) + 1, -1, np.int64)
    own, label = labels.own, labels.own_label
    if without is not None:
        stays = ~np.isin(own, without, assume_unique=True)
        own, label = own[stays], label[stays]
    found, place = np.unique(label, return_index=True)
    first[found] = own[place]
    return first
