"""Nearest neighbours of the points of a cloud, by SciPy's k-d tree."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from torchjoint.runtime.threads import num_threads

Array = npt.NDArray[Any]

#: Points that are asked for at a time, so that clouds of millions of points need little memory beyond the result.
QUERIES = 1 << 18

#: One in so many points is kept where neighbourhoods do not reach far enough.
SHARES = (2, 4, 8)


#: The spacing of a point is its mean distance to so many neighbours.
SPACING_NEIGHBORS = 4


class Neighbors(NamedTuple):
    """K nearest neighbours of every point, nearest first, the point itself left out."""

    indices: Tensor  #: [N, K] int32
    spacing: Tensor  #: [N] float32 metres: how far the closest four are on average, a measure of the local density


def nearest_neighbors(points: Tensor, count: int, reach: float = 0.0) -> Neighbors:
    """The `count` nearest neighbours of each point (all others, where the cloud has fewer), nearest first.

    The nearest neighbours of a point of a LiDAR scan may all lie along its own beam. So where all K lie closer than
    `reach`, the K nearest among half of the points are taken instead, or a quarter, or an eighth, evenly spread: the
    first of these that get that far, or else the last that has enough points.

    Duplicate points are neighbours at distance 0 of one another. Neighbours that are equally far come as SciPy's tree
    finds them: always the same for the same cloud, whatever the number of threads, but by no rule of their numbers; on
    a grid, which of several equally far points take the last places is therefore up to the tree.

    Args:
        points: [N, 3] float32, N < 2^31.
        count: K >= 1.
        reach: metres, 0 = just the nearest.
    """
    num_points = points.shape[0]
    count = max(0, min(count, num_points - 1))
    indices = torch.empty(num_points, count, dtype=torch.int32)
    spacing = torch.zeros(num_points)
    if count == 0:
        return Neighbors(indices, spacing)
    coordinates = np.ascontiguousarray(points.double().numpy())
    tree = _tree(coordinates)
    near = []
    for rows in _pieces(tree.indices):
        index, distance = _query(tree, coordinates, rows, count)
        spacing[torch.from_numpy(rows)] = torch.from_numpy(distance[:, :SPACING_NEIGHBORS]).float().mean(dim=1)
        indices.numpy()[rows] = index
        near.append(rows[distance[:, -1] < reach])
    _reach_farther(tree, coordinates, np.concatenate(near), reach, indices.numpy())
    return Neighbors(indices, spacing)


def neighbor_tables(points: Tensor, counts: Iterable[int], reach: float) -> tuple[dict[int, Tensor], Tensor]:
    """Tables of neighbours, of so many and of so many a point, at the price of one where that is possible.

    Args:
        points: [N, 3] float32.
        counts: neighbours of a point in each table; 0 = no table is needed.
        reach: as of :func:`nearest_neighbors`.

    Returns:
        the tables [N, K] int32 by their K, and the points' spacing [N] (empty where there is no table).
    """
    counts = sorted(set(counts) - {0})
    if not counts:
        return {}, torch.empty(0)
    if reach > 0:  # the fewer are not the first of the more
        found = {count: nearest_neighbors(points, count, reach) for count in counts}
        return {count: near.indices for count, near in found.items()}, found[counts[-1]].spacing
    nearest = nearest_neighbors(points, counts[-1])
    return {count: nearest.indices[:, :count] for count in counts}, nearest.spacing


def _reach_farther(tree: cKDTree, coordinates: Array, near: Array, reach: float, indices: Array) -> None:
    """Replaces the neighbours of some points by the nearest among fewer."""
    count = indices.shape[1]
    for share in SHARES:
        # In the tree's order points are near those before and after them: every second of them are an even half.
        kept = tree.indices[::share]
        if len(near) == 0 or len(kept) <= count:
            return
        thin = _tree(coordinates[kept])
        still_near = []
        for rows in _pieces(near):
            index, distance = _query(thin, coordinates, rows, count, kept)
            indices[rows] = index
            still_near.append(rows[distance[:, -1] < reach])
        near = np.concatenate(still_near)


def _tree(coordinates: Array) -> cKDTree:
    return cKDTree(coordinates, leafsize=24, balanced_tree=False, compact_nodes=False)


def _query(
    tree: cKDTree, coordinates: Array, rows: Array, count: int, members: Array | None = None
) -> tuple[Array, Array]:
    """Numbers of and distances to the neighbours of some `rows`; `members`: what the tree holds, if not all points."""
    distance, index = tree.query(coordinates[rows], k=count + 1, workers=num_threads())
    return _without_self(rows, index if members is None else members[index], distance)


def _pieces(order: Array) -> Iterator[Array]:
    """Points in the tree's own order, some at a time: queries that follow one another then touch the same memory."""
    for start in range(0, len(order), QUERIES):
        yield order[start : start + QUERIES]


def _without_self(rows: Array, index: Array, distance: Array) -> tuple[Array, Array]:
    """The point itself usually comes first, but among duplicates any of them may: drop it, or else the farthest."""
    is_self = index == rows[:, None]
    if is_self[:, 0].all():
        return index[:, 1:], distance[:, 1:]
    is_self[:, -1] |= ~is_self.any(axis=1)
    shape = (len(rows), index.shape[1] - 1)
    return index[~is_self].reshape(shape), distance[~is_self].reshape(shape)
