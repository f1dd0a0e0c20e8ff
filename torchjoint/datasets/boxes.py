"""Point instances from 3D boxes around objects."""

from __future__ import annotations

import torch
from torch import Tensor


def instances_in_boxes(points: Tensor, centers: Tensor, sizes: Tensor, rotations: Tensor) -> Tensor:
    """Assigns each point to the box that contains it; a box includes its faces.

    A point in several boxes gets the smallest box, since small objects stand in or on large objects. If several boxes
    are equally small, it gets the last of them.

    Args:
        points: [N, 3] metres.
        centers: [B, 3] centres of the boxes, metres.
        sizes: [B, 3] along each box's own axes, metres, above 0.
        rotations: [B, 3, 3]; the columns are the axes of the box.

    Returns:
        [N] int64, index of the box; -1 = in no box.
    """
    instances = torch.full((len(points),), -1, dtype=torch.int64)
    large_first = torch.argsort(sizes.prod(dim=1), descending=True, stable=True)
    for box in large_first.tolist():
        offset = (points.to(torch.float64) - centers[box]) @ rotations[box]
        instances[(offset.abs() <= sizes[box] / 2).all(dim=1)] = box
    return instances
