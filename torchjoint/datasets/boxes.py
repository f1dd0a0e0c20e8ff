"""Instances of points, from boxes around the objects."""

from __future__ import annotations

import torch
from torch import Tensor


def instances_in_boxes(points: Tensor, centers: Tensor, sizes: Tensor, rotations: Tensor) -> Tensor:
    """The box that each point lies in, its faces included.

    Of several it is the smallest, since what is small stands in or on what is large; of equally large ones the last.

    Args:
        points: [N, 3].
        centers: [B, 3] the boxes' centres.
        sizes: [B, 3] along each box's own axes, metres, above 0.
        rotations: [B, 3, 3] whose columns are the boxes' axes.

    Returns:
        [N] int64, the box's number; -1 = in none.
    """
    instances = torch.full((len(points),), -1, dtype=torch.int64)
    large_first = torch.argsort(sizes.prod(dim=1), descending=True, stable=True)
    for box in large_first.tolist():
        offset = (points.to(torch.float64) - centers[box]) @ rotations[box]
        instances[(offset.abs() <= sizes[box] / 2).all(dim=1)] = box
    return instances
