"""Step 6, regions: what lies on the border between two regions, and whether they are one.

A single chain of weak edges through a soft border joins two objects, however strong the rest of it is. So the evidence
is pooled over whole borders: every edge of the point graph that crosses one has a cost, and the mean of them counts.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torchjoint import ops
from torchjoint.point_graph import angle_between, is_convex, map_edges, rows_of
from torchjoint.regions import Planes


def crease_costs(edge_index: Tensor, planes: Planes, oriented: Tensor, convex_factor: float) -> Tensor:
    """How sharply the surface is bent along edges: 0 flat, 1 a concave right angle or more.

    With theta the angle of the two planes, min(1, 2 theta / pi) where the surface is concave, or where it is not known
    which side of it is outside; `convex_factor` times as much where it is convex: objects mostly are, and the borders
    between them concave.

    Args:
        edge_index: [2, E].
        oriented: [N] bool, whether the sign of a point's normal is known.

    Returns:
        [E] float32 in [0, 1].
    """

    def cost(edges: Tensor) -> Tensor:
        i, j = edges
        known = oriented[i] & oriented[j]
        first, second = rows_of(planes.normal, i), rows_of(planes.normal, j)
        bent = (angle_between(first, second, known) * (2 / math.pi)).clamp(max=1)
        convex = known & is_convex(rows_of(planes.mean, j) - rows_of(planes.mean, i), second - first)
        return torch.where(convex, convex_factor * bent, bent)

    return map_edges(cost, edge_index)


def with_images(crease: Tensor, disagreement: Tensor, weight: float, agreement: float) -> Tensor:
    """Costs of edges, from shape and images: c (1 - a (1 - r)) + w (1 - c) r.

    Images count where geometry is silent: their disagreement r adds to a flat edge in full and to a sharp crease not at
    all. And where they see one segment on both sides, that takes back a share `a` of what a crease costs. An edge whose
    ends no image sees together has the neutral r of eq. 6, 1 - r_o: dearer than one within what images see as one.

    Args:
        crease: [E] c in [0, 1].
        disagreement: [E] r in [0, 1].
        weight: w.
        agreement: a in [0, 1].
    """
    return crease * (1 - agreement * (1 - disagreement)) + weight * (1 - crease) * disagreement


def merge(region: Tensor, edge_index: Tensor, cost: Tensor, threshold: float, min_size: int) -> Tensor:
    """Merges regions, always those two whose border has the lowest mean cost, up to the threshold.

    What then has fewer than `min_size` points is joined to the neighbour across its cheapest border.

    Args:
        region: [N] int64 of the points.
        edge_index: [2, E] between points; edges inside a region count for nothing.
        cost: [E].

    Returns:
        [N] int64 segments 0, 1, ..., numbered by their first regions.
    """
    return _merged(region, edge_index, cost, torch.bincount(region), threshold, min_size)


def absorb(segment: Tensor, edge_index: Tensor, cost: Tensor, stays: Tensor, min_size: int) -> Tensor:
    """Joins segments of fewer than `min_size` points to their neighbours, but for those that are to stay.

    Args:
        segment: [N] int64 of the points.
        stays: [S] bool.

    Returns:
        [N] int64 segments 0, 1, ...
    """
    size = torch.bincount(segment, minlength=stays.shape[0])
    return _merged(segment, edge_index, cost, torch.where(stays, size + min_size, size), 0, min_size)


def _merged(region: Tensor, edge_index: Tensor, cost: Tensor, size: Tensor, threshold: float, min_size: int) -> Tensor:
    ends = region[edge_index]
    across = ends[0] != ends[1]
    segment = ops.merge_regions(ends[:, across], cost[across], size, threshold, min_size)
    return segment[region]
