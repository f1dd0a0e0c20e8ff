"""Step 4: projection of points into an image, and the points that a camera sees."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import torch
from scipy.spatial import ConvexHull, QhullError
from torch import Tensor

from torchjoint import ops
from torchjoint.config import VisibilityConfig
from torchjoint.scene import Frame
from torchjoint.scene.frame import camera_center

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
    return Projection(*ops.project(points, pose, intrinsics.double(), NEAREST, FARTHEST, *size, margin * size[1]))


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


def hidden_point_removal(points: Tensor, center: Tensor, radius_factor: float) -> Tensor:
    """Visibility of a point set by spherical flipping and a convex hull.

    S. Katz, A. Tal, R. Basri, "Direct Visibility of Point Sets", SIGGRAPH 2007. The sphere's radius is
    max |p - C| x N x `radius_factor`. A larger sphere keeps more points, hidden points among them. A denser cloud needs
    a larger sphere.

    Args:
        points: [N, 3] metres, world frame; none at the camera's position (the frustum's near plane guarantees this).
        center: [3] metres, C, the camera's position.
        radius_factor: see above.

    Returns:
        [N] bool, True for visible points.
    """
    visible = torch.zeros(points.shape[0], dtype=torch.bool)
    # Of duplicate points the hull has random ones: test one of them, and use its result for all.
    unique, inverse = torch.unique(points, dim=0, return_inverse=True)
    if unique.shape[0] < 5:  # too few for a hull; so few points hide nothing
        return ~visible
    seen_from = unique.double() - center
    distance = seen_from.norm(dim=1, keepdim=True)
    radius = float(distance.max()) * unique.shape[0] * radius_factor
    flipped = seen_from + 2 * (radius - distance) * seen_from / distance
    try:
        hull = ConvexHull(torch.cat([flipped, torch.zeros(1, 3, dtype=torch.float64)]).numpy(), qhull_options="Qt")
    except QhullError:  # all points lie in one plane through the camera, which is seen edge-on
        return ~visible
    on_hull = torch.zeros(unique.shape[0] + 1, dtype=torch.bool)  # the last one is the camera
    on_hull[torch.from_numpy(hull.vertices).long()] = True
    return on_hull[:-1][inverse]


#: Largest half width of a splat, pixels. Points just in front of the camera would have larger splats, which take most
#: of the time and hide whole objects.
MAX_FOOTPRINT = 8

#: Additional depth tolerance, in units of the point's spacing. On a slanted surface a neighbour's splat may lie in
#: front of a point by the distance between the two points. Twice this distance allows for uneven density.
SLANT_TOLERANCE = 2.0

#: Radius of the sphere of hidden point removal, in units of the largest distance x N. A tenth of this value hides 70 %
#: of the visible points; ten times this value shows 27 % of the hidden points (lab/studies/visibility.py).
RADIUS_FACTOR = 0.01

#: Width of the margin around the image, in image widths, whose points also take part in hidden point removal. Occluders
#: of a point are on its own ray, so points in the margin change only the hull at the image's edge.
MARGIN = 0.1


class Visible(NamedTuple):
    """The points that one image sees, and their pixels: sparse (point, pixel) pairs, one per point."""

    point: Tensor  #: [M] int64, ascending
    row: Tensor  #: [M] int64, row of the pixel that contains the point
    column: Tensor  #: [M] int64, column of this pixel
    u: Tensor  #: [M] float32, exact column, pixels
    v: Tensor  #: [M] float32, exact row, pixels
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
        points: [N, 3] float32 metres, world frame.
        spacing: [N] metres, distance of a point to its neighbours (method zbuffer only).
        intrinsics: [3, 3] pixels.
        world_to_camera: [4, 4].
        size: (H, W) pixels.
        config: the method and its parameters.
    """
    margin = MARGIN if config.method == "hidden_point_removal" else 0.0
    projected = project(points, intrinsics, world_to_camera, size, margin)
    if config.method == "hidden_point_removal":
        center = camera_center(world_to_camera)
        projected = projected.select(hidden_point_removal(points[projected.point], center, RADIUS_FACTOR))
        projected = projected.select(_inside(projected.u, projected.v, size))
    else:
        projected = projected.select(zbuffer_visible(projected, spacing, float(intrinsics[0, 0]), size, config))
    row, column = (nearest_pixel(values) for values in (projected.v, projected.u))
    return Visible(projected.point, row, column, projected.u, projected.v, projected.z)


def zbuffer_visible(
    projected: Projection, spacing: Tensor, focal: float, size: tuple[int, int], config: VisibilityConfig
) -> Tensor:
    """Visibility by a z-buffer of splats: each point is a square with a size proportional to its spacing.

    With one size for all points, hidden points would appear through sparse parts of a cloud, or dense parts would hide
    too many points.

    Args:
        projected: M points in the image.
        spacing: [N] metres.
        focal: focal length, pixels.
        size: (H, W) pixels.
        config: footprint and depth tolerance.

    Returns:
        [M] bool, True for visible points.
    """
    width = spacing[projected.point]
    reach = (config.footprint * width * focal / projected.z).round().clamp(max=MAX_FOOTPRINT).to(torch.int64)
    row, column = nearest_pixel(projected.v), nearest_pixel(projected.u)
    nearest = ops.splat_depth(row, column, projected.z, reach, *size)
    tolerance = config.depth_tolerance * projected.z + SLANT_TOLERANCE * width
    return projected.z <= nearest[row, column] + tolerance
