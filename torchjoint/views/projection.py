"""Step 4: projection of points into an image; hidden points are not removed here."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint import ops
from torchjoint.scene import Frame

#: Range of depths in front of a camera, in the cloud's unit. It is so wide that the unit has no effect.
NEAREST, FARTHEST = 1e-9, torch.finfo(torch.float32).max


class Projection(NamedTuple):
    """Points that project into an image."""

    point: Tensor  #: [M] int64, ascending
    u: Tensor  #: [M] float32, column in pixels; pixel centres have integer coordinates
    v: Tensor  #: [M] float32, row in pixels
    z: Tensor  #: [M] float32, metres along the optical axis

    def select(self, mask: Tensor) -> Projection:
        """The points where `mask` [M] is True."""
        index = torch.nonzero(mask).squeeze(1)
        return Projection(*(values[index] for values in self))


def project(
    points: Tensor, intrinsics: Tensor, world_to_camera: Tensor, size: tuple[int, int], margin: float = 0.0
) -> Projection:
    """Projects points into an image; keeps the points in front of the camera and inside the image frame.

    Args:
        points: [N, 3] metres, world frame; float32 or float64.
        intrinsics: [3, 3] pixels.
        world_to_camera: [4, 4].
        size: (H, W) pixels.
        margin: width added to the image frame on each side, in image widths.
    """
    pose = world_to_camera.double()
    if points.dtype == torch.float64:  # far from the origin: use coordinates relative to the first point
        origin = points[:1]
        points, pose = (points - origin).float(), pose.clone()
        pose[:3, 3] += pose[:3, :3] @ origin[0]
    camera = (pose, intrinsics.double())
    return Projection(*ops.project(points, *camera, NEAREST, FARTHEST, *size, margin * size[1]))


def nearest_pixel(coordinate: Tensor) -> Tensor:
    """The rows or columns, int64, of the pixels that contain coordinates; pixel centres have integer coordinates."""
    return torch.floor(coordinate + 0.5).to(torch.int64)


def _inside(u: Tensor, v: Tensor, size: tuple[int, int]) -> Tensor:
    height, width = size
    column, row = nearest_pixel(u), nearest_pixel(v)
    return (column >= 0) & (column < width) & (row >= 0) & (row < height)


def in_any_view(points: Tensor, frames: Iterable[Frame]) -> Tensor:
    """Whether each point is inside the view frustum of at least one camera; hidden points count, too.

    Args:
        points: [N, 3] metres, world frame.
        frames: any number.

    Returns:
        [N] bool.
    """
    inside = torch.zeros(len(points), dtype=torch.bool)
    for frame in frames:
        inside[project(points, frame.intrinsics, frame.world_to_camera, frame.size).point] = True
    return inside
