"""Resamples depth and label images to the colour image by nearest neighbour: neither may be interpolated."""

from __future__ import annotations

import torch
from torch import Tensor


def register_depth(depth: Tensor, depth_intrinsics: Tensor, intrinsics: Tensor, size: tuple[int, int]) -> Tensor:
    """Resamples depth for a second camera with the same position and orientation.

    Args:
        depth: [h, w] metres along z, 0 = unknown.
        depth_intrinsics: [3, 3] of the depth image; pixel centres at integer coordinates; no skew.
        intrinsics: [3, 3] of the second camera; no skew.
        size: (H, W) of the second camera's images.

    Returns:
        [H, W] metres; 0 also outside of the depth image.

    Raises:
        ValueError: intrinsics with skew.
    """
    if depth_intrinsics[0, 1] != 0 or intrinsics[0, 1] != 0:
        raise ValueError("intrinsics: expected cameras without skew")
    indices, reached = [], []
    for axis in (1, 0):  # rows by y, columns by x
        focal, center = intrinsics[axis, axis], intrinsics[axis, 2]
        ray = (torch.arange(size[1 - axis], dtype=torch.float64) - center) / focal
        place = (ray * depth_intrinsics[axis, axis] + depth_intrinsics[axis, 2]).round()
        reached.append((place >= 0) & (place < depth.shape[1 - axis]))
        indices.append(place.clamp(0, depth.shape[1 - axis] - 1).long())
    inside = reached[0][:, None] & reached[1]
    return torch.where(inside, depth[indices[0]][:, indices[1]], 0)


def resize_nearest(image: Tensor, size: tuple[int, int]) -> Tensor:
    """Resizes labels or depth [h, w] to (H, W) by nearest neighbour."""
    if image.shape == size:
        return image
    row, column = (
        ((torch.arange(new, dtype=torch.float64) + 0.5) * old / new).long()
        for new, old in zip(size, image.shape, strict=True)
    )
    return image[row[:, None], column]
