"""Step 4: points in an image, hidden or not."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint import ops
from torchjoint.config import VisibilityConfig
from torchjoint.scene import Frame


class Projection(NamedTuple):
    """Points in front of a camera, in its image."""

    point: Tensor  #: [M] int64, ascending
    u: Tensor  #: [M] float32, column in pixels; pixel centres at integers
    v: Tensor  #: [M] float32, row in pixels
    z: Tensor  #: [M] float32, metres along the optical axis

    def select(self, mask: Tensor) -> Projection:
        """The points where `mask` [M] is True."""
        index = torch.nonzero(mask).squeeze(1)
        return Projection(*(values[index] for values in self))


def project(
    points: Tensor,
    intrinsics: Tensor,
    world_to_camera: Tensor,
    size: tuple[int, int],
    config: VisibilityConfig,
    margin: float = 0.0,
) -> Projection:
    """Projects points into an image and keeps those between near and far and inside the frame.

    Args:
        margin: how much larger than the image the frame is taken on each side, image widths.
    """
    camera = (world_to_camera.double(), intrinsics.double())
    return Projection(*ops.project(points, *camera, config.near, config.far, *size, margin * size[1]))


def _nearest_pixel(coordinate: Tensor) -> Tensor:
    return torch.floor(coordinate + 0.5).to(torch.int64)


def _inside(u: Tensor, v: Tensor, size: tuple[int, int]) -> Tensor:
    height, width = size
    column, row = _nearest_pixel(u), _nearest_pixel(v)
    return (column >= 0) & (column < width) & (row >= 0) & (row < height)


def in_any_view(points: Tensor, frames: Iterable[Frame], config: VisibilityConfig | None = None) -> Tensor:
    """Whether a point is inside the frame of any camera, and in front of it; hidden ones count.

    Args:
        points: [N, 3].
        frames: any number.
        config: near and far; default: the default's.

    Returns:
        [N] bool.
    """
    config = config or VisibilityConfig()
    inside = torch.zeros(len(points), dtype=torch.bool)
    for frame in frames:
        inside[project(points, frame.intrinsics, frame.world_to_camera, frame.size, config).point] = True
    return inside
