"""Nearest neighbours of the points of a cloud, by SciPy's k-d tree."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from torchjoint.threads import num_threads

Array = npt.NDArray[Any]

#: Points that are asked for at a time, so that clouds of millions of points need little memory beyond the result.
QUERIES = 1 << 18


class Neighbors(NamedTuple):
    """K nearest neighbours of every point, nearest first, the point itself left out."""

    indices: Tensor  #: [N, K] int32
    spacing: Tensor  #: [N] float32 metres: how far the closest four are on average, a measure of the local density


def nearest_neighbors(points: Tensor, count: int) -> Neighbors:
    """The `count` nearest neighbours of each point (all others, where the cloud has fewer), nearest first.

    Duplicate points are neighbours at distance 0 of one another. Neighbours that are equally far come as SciPy's tree
    finds them: always the same for the same cloud, whatever the number of threads, but by no rule of their numbers; on
    a grid, which of several equally far points take the last places is therefore up to the tree.

    Args:
        points: [N, 3] float32, N < 2^31.
        count: K >= 1.
    """
    num_points = points.shape[0]
    count = min(count, num_points - 1)
    indices = torch.empty(num_points, count, dtype=torch.int32)
    spacing = torch.zeros(num_points)
    if count == 0:
        return Neighbors(indices, spacing)
    coordinates = np.ascontiguousarray(points.double().numpy())
    tree = cKDTree(coordinates, leafsize=24, balanced_tree=False, compact_nodes=False)
    # Asked in the tree's own order, queries that follow one another touch the same memory: a sixth less time.
    for start in range(0, num_points, QUERIES):
        rows = tree.indices[start : start + QUERIES]
        distance, index = tree.query(coordinates[rows], k=count + 1, workers=num_threads())
        index, distance = _without_self(rows, index, distance)
        indices.numpy()[rows] = index
        spacing[torch.from_numpy(rows)] = torch.from_numpy(distance[:, :4]).float().mean(dim=1)
    return Neighbors(indices, spacing)


def _without_self(rows: Array, index: Array, distance: Array) -> tuple[Array, Array]:
    """The point itself usually comes first, but among duplicates any of them may: drop it, or else the farthest."""
    is_self = index == rows[:, None]
    if is_self[:, 0].all():
        return index[:, 1:], distance[:, 1:]
    is_self[:, -1] |= ~is_self.any(axis=1)
    shape = (len(rows), index.shape[1] - 1)
    return index[~is_self].reshape(shape), distance[~is_self].reshape(shape)
