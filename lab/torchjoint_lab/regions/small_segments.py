"""Step 6, method regions: merges regions by the mean cost of their boundaries, and small ones at last."""

from __future__ import annotations

import torch
from torch import Tensor

from torchjoint import ops
from torchjoint.runtime.threads import all_threads


def join_small(segment: Tensor, edge_index: Tensor, cost: Tensor, stays: Tensor, min_size: int) -> Tensor:
    """Joins each segment of fewer than `min_size` points to a neighbour, unless `stays` protects the segment.

    Args:
        segment: [N] int64, segment of each point, 0 ... S - 1.
        edge_index: [2, E] int64, edges between points.
        cost: [E] float32 in [0, 1024].
        stays: [S] bool, True for segments that are not joined.
        min_size: points.

    Returns:
        [N] int64 segments 0, 1, ...
    """
    size = torch.bincount(segment, minlength=stays.shape[0])
    return merge_sized(segment, edge_index, cost, torch.where(stays, size + min_size, size), 0, min_size)


def merge(region: Tensor, edge_index: Tensor, cost: Tensor, threshold: float, min_size: int) -> Tensor:
    """Repeatedly merges the two regions with the lowest mean boundary cost, up to the threshold.

    Then each region of fewer than `min_size` points is joined to the neighbour with the lowest mean boundary cost.

    Args:
        region: [N] int64, region of each point, 0 ... R - 1.
        edge_index: [2, E] int64, edges between points; edges inside a region are ignored.
        cost: [E] float32 in [0, 1024].
        threshold: largest mean boundary cost of two regions that merge.
        min_size: points.

    Returns:
        [N] int64 segments 0, 1, ..., numbered by their first regions.
    """
    return merge_sized(region, edge_index, cost, torch.bincount(region), threshold, min_size)


def merge_sized(
    region: Tensor, edge_index: Tensor, cost: Tensor, size: Tensor, threshold: float, min_size: int
) -> Tensor:
    """As :func:`merge`, but `size` [R] int64 gives the size of each region instead of its number of points."""
    with all_threads():
        return ops.merge_regions(region[edge_index], cost, size, threshold, min_size)[region]
