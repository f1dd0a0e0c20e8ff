"""Step 4: which points an image sees, and in which pixels."""

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


class Visible(NamedTuple):
    """The points one image sees, and where: sparse (point, pixel) pairs, one a point."""

    point: Tensor  #: [M] int64, ascending
    row: Tensor  #: [M] int64, of the pixel the point falls in
    column: Tensor  #: [M] int64
    u: Tensor  #: [M] float32, exact column
    v: Tensor  #: [M] float32, exact row
    z: Tensor  #: [M] float32, metres along the optical axis


def visible_points(
    points: Tensor,
    spacing: Tensor,
    intrinsics: Tensor,
    world_to_camera: Tensor,
    size: tuple[int, int],
    config: VisibilityConfig,
) -> Visible:
    """The points that one camera sees: in front of it, inside the frame, and not hidden by other points.

    Args:
        points: [N, 3] float32, world frame.
        spacing: [N] metres, distance of a point to its neighbours (z-buffer only).
        intrinsics: [3, 3].
        world_to_camera: [4, 4].
        size: (H, W) pixels.
    """
    margin = config.margin if config.method == "hidden_point_removal" else 0.0
    projected = project(points, intrinsics, world_to_camera, size, config, margin)
    if config.method == "hidden_point_removal":
        center = -(world_to_camera[:3, :3].T @ world_to_camera[:3, 3])
        projected = projected.select(hidden_point_removal(points[projected.point], center, config.radius_factor))
        projected = projected.select(_inside(projected.u, projected.v, size))
    else:
        projected = projected.select(zbuffer_visible(projected, spacing, float(intrinsics[0, 0]), size, config))
    row, column = (_nearest_pixel(values) for values in (projected.v, projected.u))
    return Visible(projected.point, row, column, projected.u, projected.v, projected.z)


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


def zbuffer_visible(
    projected: Projection, spacing: Tensor, focal: float, size: tuple[int, int], config: VisibilityConfig
) -> Tensor:
    """Visibility by a z-buffer in which every point is a square as wide as its own spacing.

    One width for all points would see through the sparse parts of a cloud, or fatten the dense ones.

    Returns:
        [M] bool.
    """
    width = spacing[projected.point]
    reach = (config.footprint * width * focal / projected.z).round().clamp(max=config.max_footprint).to(torch.int64)
    row, column = _nearest_pixel(projected.v), _nearest_pixel(projected.u)
    nearest = ops.splat_depth(row, column, projected.z, reach, *size)
    # On a slanted surface the splat of a neighbour may lie in front of a point by as much as their distance.
    tolerance = config.depth_tolerance + config.slant_tolerance * width
    return projected.z <= nearest[row, column] + tolerance


def hidden_point_removal(points: Tensor, center: Tensor, radius_factor: float) -> Tensor:
    """Visibility of a point set by spherical flipping and a convex hull (Katz, Tal, Basri 2007).

    The sphere's radius is max |p - C| x N x `radius_factor`: a larger sphere keeps more points, hidden ones among
    them, and the denser the cloud the larger it must be.

    Args:
        points: [N, 3] world frame; none at the camera itself (the frustum's near plane sees to that).
        center: [3] the camera's.

    Returns:
        [N] bool.
    """
    visible = torch.zeros(points.shape[0], dtype=torch.bool)
    # Copies of a point would all be on the hull or none, at random: keep the first, let the others follow it.
    unique, inverse = torch.unique(points, dim=0, return_inverse=True)
    if unique.shape[0] < 5:  # no hull of the flipped points and the centre: nothing hides so few
        return ~visible
    from open3d import geometry, utility

    cloud = geometry.PointCloud(utility.Vector3dVector(unique.double().numpy()))
    distance = (unique.double() - center).norm(dim=1)
    try:
        _, kept = cloud.hidden_point_removal(center.numpy(), float(distance.max()) * unique.shape[0] * radius_factor)
    except RuntimeError:  # qhull: all points in one plane through the camera, seen edge-on
        return ~visible
    visible_unique = torch.zeros(unique.shape[0], dtype=torch.bool)
    visible_unique[torch.tensor(kept, dtype=torch.int64)] = True
    return visible_unique[inverse]


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
