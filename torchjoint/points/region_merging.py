"""Step 6, regions: what lies on the border between two regions, and whether they are one.

A single chain of weak edges through a soft border joins two objects, however strong the rest of it is. So the evidence
is pooled over whole borders: every edge of the point graph that crosses one has a cost, and the mean of them counts.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchjoint import ops


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
