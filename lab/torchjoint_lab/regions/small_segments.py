"""Step 6, method regions: joins small segments to their neighbours."""

from __future__ import annotations

import torch
from torch import Tensor

from torchjoint.segments.planes import merge_sized


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
