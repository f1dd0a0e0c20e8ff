"""Whether the depth edges of a LiDAR scan fall on edges of an image: what tells a wrong pose without any colours.

After J. Levinson and S. Thrun, "Automatic Online Calibration of Cameras and Lasers", RSS 2013. Where a scan's depth
jumps, one thing ends before another, and mostly the image has an edge there. So how far it jumps between neighbouring
points goes with how strong the image's edges are between them. If the pose is right, that is much less so as soon as
the image is shifted a little, which is what turning the camera a little does. If it is wrong, it makes no difference.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from torchjoint.config import VisibilityConfig
from torchjoint.images.gradient_boundary import GradientBoundary
from torchjoint.images.smoothing import smooth
from torchjoint.runtime.threads import one_thread_per_operation, parallel_map
from torchjoint.scene import Frame, Scene
from torchjoint.views.projection import Projection, project
from torchjoint.views.visibility import visible_points

#: Images are looked at with their longer side this long, pixels; the other lengths here are pixels of that image.
SIDE = 640

#: Blur of the edges, about what calibrations are off by; and of the mean that they are compared with.
BLUR, SURROUNDINGS = 2.5, 10.0

#: Neighbours of a point, and how far they may be: the gap between two beams of a coarse LiDAR.
NEIGHBORS, REACH = 6, 16.0

#: Change of depth at which a jump begins to count, and further change until it counts in full; logarithms.
SMALLEST_JUMP, JUMP_RANGE = 0.05, 0.2

#: Jumps there have to be in view for a verdict, and points whose neighbours are looked at.
MIN_JUMPS, MAX_QUERIES = 800.0, 20_000

#: Standard deviation that edge strength must have, from 0 to 1, in an image that shows something.
MIN_CONTRAST = 0.01

#: Share of the points in view that must be in plain sight for a scan.
MIN_VISIBLE = 0.95

#: The shifts that the pose is compared with, (down, right): far enough for edges to part, and all around.
SHIFTS = [
    (round(radius * math.sin(angle)), round(radius * math.cos(angle)))
    for ring, radius in enumerate((30, 45, 60, 75))
    for angle in (math.pi / 6 * (step + ring / 4) for step in range(12))
]


class EdgeAlignment(NamedTuple):
    """How well depth edges and image edges agree, mean over the frames.

    Attributes:
        correlation: of depth jumps and image edges, -1 to 1, at the pose given.
        significance: by how much that is better than with shifted images, in standard deviations of those.
    """

    correlation: float
    significance: float


def edge_alignment(
    scene: Scene, frames: Sequence[Frame], spacing: Tensor, config: VisibilityConfig
) -> EdgeAlignment | None:
    """Compares depth edges and image edges of a cloud that was taken from about one place, as a LiDAR scan is.

    Args:
        scene: its points.
        frames: of the scene; at the poses they have.
        spacing: [N] metres, of the points.
        config: near and far.

    Returns:
        None where that tells nothing: the cloud is no scan, there are hardly any jumps of depth in view, or the images
        are blank.
    """
    with one_thread_per_operation():
        rows = parallel_map(lambda frame: _correlations(scene, frame, spacing, config), frames)
    known = [row for row in rows if row is not None]
    if not known:
        return None
    given, *shifted = torch.stack(known).mean(dim=0)
    others = torch.stack(shifted)
    return EdgeAlignment(float(given), float((given - others.mean()) / others.std().clamp(min=1e-9)))


def _correlations(scene: Scene, frame: Frame, spacing: Tensor, config: VisibilityConfig) -> Tensor | None:
    """[1 + shifts] float64, the first without a shift."""
    projection = project(scene.points, frame.intrinsics, frame.world_to_camera, frame.size, config)
    if len(projection.point) <= NEIGHBORS or not _is_scan(scene, frame, spacing, config, projection):
        return None
    edges, scale = _image_edges(frame.image)
    if edges is None:
        return None
    row, column, jump = _depth_jumps(projection, scale)
    rows = []
    for down, right in [(0, 0), *SHIFTS]:
        there = (row + down, column + right)
        inside = (there[0] >= 0) & (there[0] < edges.shape[0]) & (there[1] >= 0) & (there[1] < edges.shape[1])
        if float(jump[inside].sum()) < MIN_JUMPS:
            return None
        rows.append(_correlation(edges[there[0][inside], there[1][inside]], jump[inside]))
    return torch.stack(rows)


def _is_scan(scene: Scene, frame: Frame, spacing: Tensor, config: VisibilityConfig, projection: Projection) -> bool:
    """Whether hardly any point hides another: in a cloud of many views, what is behind is there, too."""
    thin = replace(config, method="zbuffer", footprint=0.1)
    visible = visible_points(scene.points, spacing, frame.intrinsics, frame.world_to_camera, frame.size, thin)
    return len(visible.point) >= MIN_VISIBLE * len(projection.point)


def _image_edges(image: Tensor) -> tuple[Tensor | None, float]:
    """Edge strength [h, w] against its surroundings, None in a blank image; and its size in proportion to the image."""
    scale = SIDE / max(image.shape[1:])
    size = [max(1, round(side * scale)) for side in image.shape[1:]]
    small = torch.nn.functional.interpolate(image[None], size, mode="bilinear", antialias=True)
    edges = smooth(GradientBoundary(smoothing=1.0, contrast=8.0)(small)[None], BLUR)
    if float(edges.std()) < MIN_CONTRAST:
        return None, scale
    away = edges - smooth(edges, SURROUNDINGS)
    return (away / (smooth(away**2, SURROUNDINGS) + 1e-4).sqrt())[0, 0].double(), scale


def _depth_jumps(projection: Projection, scale: float) -> tuple[Tensor, Tensor, Tensor]:
    """Row and column between points that are neighbours in the image, and from 0 to 1 whether depth jumps there."""
    place = (np.stack([projection.v.numpy(), projection.u.numpy()], axis=1).astype(np.float64) + 0.5) * scale - 0.5
    first = np.arange(0, len(place), -(-len(place) // MAX_QUERIES))
    # A point's nearest is itself, or one at the same place.
    distance, second = cKDTree(place).query(place[first], k=NEIGHBORS + 1, distance_upper_bound=REACH)
    near = np.isfinite(distance[:, 1:])
    first, second = np.repeat(first[:, None], NEIGHBORS, axis=1)[near], second[:, 1:][near]
    depth = np.log(projection.z.double().numpy())
    jump = np.clip((np.abs(depth[first] - depth[second]) - SMALLEST_JUMP) / JUMP_RANGE, 0, 1)
    row, column = np.floor((place[first] + place[second]) / 2 + 0.5).astype(np.int64).T
    return torch.from_numpy(row), torch.from_numpy(column), torch.from_numpy(jump)


def _correlation(first: Tensor, second: Tensor) -> Tensor:
    first, second = first - first.mean(), second - second.mean()
    return (first * second).sum() / ((first * first).sum() * (second * second).sum()).sqrt().clamp(min=1e-12)
