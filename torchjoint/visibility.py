"""Step 4: which points an image sees, and in which pixels."""

from __future__ import annotations

from typing import NamedTuple

import kornia
import torch
from torch import Tensor

from torchjoint.config import VisibilityConfig


class Projection(NamedTuple):
    """Points in front of a camera, in its image."""

    point: Tensor  #: [M] int64, ascending
    u: Tensor  #: [M] float32, column in pixels; pixel centres at integers
    v: Tensor  #: [M] float32, row in pixels
    z: Tensor  #: [M] float32, metres along the optical axis

    def select(self, mask: Tensor) -> Projection:
        """The points where `mask` [M] is True."""
        return Projection(*(values[mask] for values in self))


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
        projected = projected.select(_inside(projected.u, projected.v, size, 0.0))
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
    in_camera = kornia.geometry.transform_points(world_to_camera[None], points[None].double())[0]
    z = in_camera[:, 2]
    # kornia projects points behind the camera to ordinary pixels: leave them out first.
    point = torch.nonzero((z > config.near) & (z < config.far)).squeeze(1)
    pixels = kornia.geometry.project_points(in_camera[point], intrinsics)
    projected = Projection(point, pixels[:, 0].float(), pixels[:, 1].float(), z[point].float())
    return projected.select(_inside(projected.u, projected.v, size, margin * size[1]))


def zbuffer_visible(
    projected: Projection, spacing: Tensor, focal: float, size: tuple[int, int], config: VisibilityConfig
) -> Tensor:
    """Visibility by a z-buffer in which every point is a square as wide as its own spacing.

    One width for all points would see through the sparse parts of a cloud, or fatten the dense ones.

    Returns:
        [M] bool.
    """
    height, width = size
    radius = (config.footprint * spacing[projected.point] * focal / projected.z).round()
    radius = radius.clamp(max=config.max_footprint).to(torch.int64)
    row, column = _nearest_pixel(projected.v), _nearest_pixel(projected.u)
    buffer = torch.full((height * width,), torch.inf)
    for reach in range(config.max_footprint + 1):
        wide_enough = radius >= reach
        z, near_row, near_column = projected.z[wide_enough], row[wide_enough], column[wide_enough]
        for down, right in _ring(reach):
            r, c = near_row + down, near_column + right
            inside = (r >= 0) & (r < height) & (c >= 0) & (c < width)
            buffer.scatter_reduce_(0, (r * width + c)[inside], z[inside], "amin")
    # On a slanted surface the splat of a neighbour may lie in front of a point by as much as their distance.
    tolerance = config.depth_tolerance + config.slant_tolerance * spacing[projected.point]
    return projected.z <= buffer[row * width + column] + tolerance


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


def _ring(reach: int) -> list[tuple[int, int]]:
    """Offsets (down, right) with max(|down|, |right|) = reach."""
    steps = range(-reach, reach + 1)
    return [(down, right) for down in steps for right in steps if max(abs(down), abs(right)) == reach]


def _nearest_pixel(coordinate: Tensor) -> Tensor:
    return torch.floor(coordinate + 0.5).to(torch.int64)


def _inside(u: Tensor, v: Tensor, size: tuple[int, int], margin: float) -> Tensor:
    height, width = size
    column, row = _nearest_pixel(u), _nearest_pixel(v)
    return (column >= -margin) & (column < width + margin) & (row >= -margin) & (row < height + margin)
