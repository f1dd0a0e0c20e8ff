"""Voxel subsampling of a cloud, before step 3."""

from __future__ import annotations

import torch
from torch import Tensor


def voxel_subsample(points: Tensor, size: float) -> Tensor:
    """Keeps one point per cubic voxel: the point nearest to the voxel's centre (ties: the first point).

    Args:
        points: [N, 3] metres.
        size: side of a voxel, metres; about the spacing of the points that are kept.

    Returns:
        [M] int64 indices of the points that are kept, ascending.

    Raises:
        ValueError: `size` is not positive, or so small that voxels cannot be numbered.

    >>> voxel_subsample(torch.tensor([[0.1, 0.1, 0.1], [0.5, 0.5, 0.4], [1.2, 0.0, 0.0]]), 1.0)
    tensor([1, 2])
    """
    if not size > 0:
        raise ValueError(f"size: expected more than 0 metres, got {size}")
    scaled = (points.double() - points.double().amin(0)) / size
    if float(scaled.max()) >= 1 << 20:
        raise ValueError(f"size: {size} m is too small for a cloud {float(scaled.max()) * size:.3g} m wide")
    cell = scaled.long()
    off_center = (scaled - cell - 0.5).square().sum(1)
    voxel = torch.unique((cell[:, 0] << 40) + (cell[:, 1] << 20) + cell[:, 2], return_inverse=True)[1]
    count = int(voxel.max()) + 1 if len(voxel) else 0
    nearest = torch.full((count,), torch.inf, dtype=torch.float64).scatter_reduce(0, voxel, off_center, "amin")
    place = torch.arange(len(points))
    best = torch.where(off_center == nearest[voxel], place, len(points))
    return torch.full((count,), len(points)).scatter_reduce(0, voxel, best, "amin").sort().values
