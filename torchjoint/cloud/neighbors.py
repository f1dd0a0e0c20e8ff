"""Step 3: nearest neighbours of the points of a cloud."""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from torchjoint import ops
from torchjoint.runtime.threads import all_threads, num_threads

Array = npt.NDArray[Any]

#: Number of points per query of SciPy's tree, so that large scans need little memory besides the result.
QUERIES = 1 << 18

#: Where neighbours do not reach far enough, they are searched among every 2nd, 4th or 8th point.
SHARES = (2, 4, 8)

#: Clouds with at least this many points are processed in an order in which neighbours are near in memory.
ORDERED = 1 << 19
#: Cells along the longest side of the cloud. With 2^8, float32 can represent the numbers of all 2^24 cells.
CELLS = 1 << 8

#: The spacing of a point is its mean distance to this many nearest neighbours.
SPACING_NEIGHBORS = 4


class Neighbors(NamedTuple):
    """K nearest neighbours of every point, nearest first, without the point itself."""

    indices: Tensor  #: [N, K] int32
    spacing: Tensor  #: [N] float32 metres: mean distance to the four nearest neighbours, a measure of local density


def nearest_neighbors(points: Tensor, count: int, reach: float = 0.0) -> Neighbors:
    """The `count` nearest neighbours of each point (all other points if the cloud has fewer), nearest first.

    In a LiDAR scan all nearest neighbours of a point may lie on the point's own beam. So if all K neighbours are closer
    than `reach`, the K nearest are searched again among every second point, then every fourth, then every eighth. The
    first search that reaches far enough counts, or else the last one that has enough points.

    Duplicate points are neighbours of one another at distance 0. Of equally far neighbours the one with the smaller
    number comes first (:func:`torchjoint.ops.nearest_neighbors`). In a search among fewer points, equally far
    neighbours have the order of SciPy's tree, which is always the same for the same cloud.

    Args:
        points: [N, 3] float32 metres, N < 2^31.
        count: K >= 1.
        reach: metres; 0 = always the nearest neighbours.

    Returns:
        indices [N, K] int32 and spacing [N] float32 metres.
    """
    with all_threads():
        indices, distances = ops.nearest_neighbors(points, count, count if reach > 0 else SPACING_NEIGHBORS)
    if indices.shape[1] == 0:
        return Neighbors(indices, torch.zeros(len(points), dtype=torch.float32))
    if reach > 0:
        _reach_farther(points, torch.nonzero(distances[:, -1] < reach).squeeze(1).numpy(), reach, indices.numpy())
    return Neighbors(indices, distances[:, :SPACING_NEIGHBORS].float().mean(dim=1))


def neighbor_tables(points: Tensor, counts: Iterable[int], reach: float) -> tuple[dict[int, Tensor], Tensor]:
    """Several tables of neighbours with different K, computed with one search if possible.

    Args:
        points: [N, 3] float32 metres.
        counts: K of each table; 0 = no table.
        reach: metres, as in :func:`nearest_neighbors`.

    Returns:
        the tables K -> [N, K] int32, and the points' spacing [N] metres (empty if there is no table).
    """
    counts = sorted(set(counts) - {0})
    if not counts:
        return {}, torch.empty(0, dtype=torch.float32)
    if reach > 0:  # the smaller table is then not the first columns of the larger one
        found = {count: nearest_neighbors(points, count, reach) for count in counts}
        return {count: near.indices for count, near in found.items()}, found[counts[-1]].spacing
    nearest = nearest_neighbors(points, counts[-1])
    return {count: nearest.indices[:, :count] for count in counts}, nearest.spacing


def order_along_space(points: Tensor) -> Tensor | None:
    """An order of the points in which neighbours are mostly near each other: cells along a Z-order curve.

    Args:
        points: [N, 3] metres, finite.

    Returns:
        [N] int32; None for small clouds, which fit in a processor's cache.
    """
    if len(points) < ORDERED:
        return None
    low, high = points.double().aminmax(dim=0)
    scale = CELLS / float((high - low).max().clamp(min=torch.finfo(torch.float64).tiny))
    code = torch.zeros(len(points), dtype=torch.int32)
    for axis in range(3):
        cell = ((points[:, axis] - low[axis]) * scale).clamp(0, CELLS - 1).int()
        for shift, kept in ((8, 0x00F00F), (4, 0x0C30C3), (2, 0x249249)):  # the bits move to every third place
            cell = (cell | cell << shift) & kept
        code |= cell << axis
    return torch.argsort(code, stable=True).int()


def _reach_farther(points: Tensor, near: Array, reach: float, indices: Array) -> None:
    """Replaces the neighbours of the points `near` by neighbours among fewer points, which are farther away."""
    if len(near) == 0:
        return
    count, coordinates = indices.shape[1], np.ascontiguousarray(points.double().numpy())
    tree = _tree(coordinates)
    for share in SHARES:
        # In the tree's order consecutive points are near each other: every second point is an evenly spread half.
        kept = tree.indices[::share]
        if len(near) == 0 or len(kept) <= count:
            return
        thin = _tree(coordinates[kept])
        still_near = []
        for start in range(0, len(near), QUERIES):  # in the tree's order: consecutive queries access the same memory
            rows = near[start : start + QUERIES]
            distance, index = thin.query(coordinates[rows], k=count + 1, workers=num_threads())
            indices[rows], distance = _without_self(rows, kept[index], distance)
            still_near.append(rows[distance[:, -1] < reach])
        near = np.concatenate(still_near)


def _tree(coordinates: Array) -> cKDTree:
    return cKDTree(coordinates, leafsize=24, balanced_tree=False, compact_nodes=False)


def _without_self(rows: Array, index: Array, distance: Array) -> tuple[Array, Array]:
    """Removes the point itself, which is not always first if it has duplicates; if it is absent, the farthest."""
    is_self = index == rows[:, None]
    if is_self[:, 0].all():
        return index[:, 1:], distance[:, 1:]
    is_self[:, -1] |= ~is_self.any(axis=1)
    shape = (len(rows), index.shape[1] - 1)
    return index[~is_self].reshape(shape), distance[~is_self].reshape(shape)
