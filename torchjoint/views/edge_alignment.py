"""Check before step 4: do the depth edges of a LiDAR scan fall on image edges? The check needs no colours.

After J. Levinson and S. Thrun, "Automatic Online Calibration of Cameras and Lasers", RSS 2013. Where the depth of a
scan jumps, an object ends in front of another, and the image usually has an edge there. So depth jumps between
neighbouring points correlate with the strength of the image edges between them. If the pose is right, a small shift of
the image (which acts like a small rotation of the camera) lowers this correlation clearly. If the pose is wrong, a
shift makes no difference.
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
from torchjoint.scene import Cloud, Frame
from torchjoint.views.color_agreement import correlation
from torchjoint.views.projection import Projection, project
from torchjoint.views.visibility import visible_points

#: Longer side of the resized image, pixels; the other lengths in this file are pixels of the resized image.
SIDE = 640

#: Standard deviations of the Gaussian that blurs the edges (about the error of a calibration), and of their local mean.
BLUR, SURROUNDINGS = 2.5, 10.0

#: Number of neighbours of a point, and their largest distance: the gap between two beams of a coarse LiDAR.
NEIGHBORS, REACH = 6, 16.0

#: Change of log depth from which a jump counts, and the further change until it counts fully.
SMALLEST_JUMP, JUMP_RANGE = 0.05, 0.2

#: Smallest sum of jumps in view for a verdict, and largest number of points whose neighbours are searched.
MIN_JUMPS, MAX_QUERIES = 800.0, 20_000

#: Smallest standard deviation of the edge strength (0 to 1) in an image that is not blank.
MIN_CONTRAST = 0.01

#: Smallest share of the points in view that is visible if the cloud is one scan.
MIN_VISIBLE = 0.95

#: Shifts (down, right) of the image for comparison: in all directions, and so far that shifted edges do not overlap.
EDGE_SHIFTS = [
    (round(radius * math.sin(angle)), round(radius * math.cos(angle)))
    for ring, radius in enumerate((30, 45, 60, 75))
    for angle in (math.pi / 6 * (step + ring / 4) for step in range(12))
]


class EdgeAlignment(NamedTuple):
    """Agreement of depth edges and image edges, mean over the frames.

    Attributes:
        correlation: correlation of depth jumps and image edges at the given pose, -1 to 1.
        significance: (correlation - mean correlation with shifted images) / standard deviation of the latter.
    """

    correlation: float
    significance: float


def combined(correlations: Sequence[Tensor]) -> EdgeAlignment | None:
    """The alignment of several frames, from the :func:`edge_correlations` of each; None: no frame has a verdict."""
    if not correlations:
        return None
    given, *shifted = torch.stack(list(correlations)).mean(dim=0)
    others = torch.stack(shifted)
    return EdgeAlignment(float(given), float((given - others.mean()) / others.std().clamp(min=1e-9)))


def edge_correlations(cloud: Cloud, frame: Frame, spacing: Tensor, config: VisibilityConfig) -> Tensor | None:
    """Correlations of depth edges and image edges, for a cloud from about one position, such as a LiDAR scan.

    Args:
        cloud: the points.
        frame: a frame, with the pose to check.
        spacing: [N] metres, spacing of the points.
        config: parameters of the visibility.

    Returns:
        [1 + number of EDGE_SHIFTS] float64, the first without shift. None if no verdict is possible: the cloud is not a
        scan, too few depth jumps are in view, or the image is blank.
    """
    projection = project(cloud.points, frame.intrinsics, frame.world_to_camera, frame.size)
    if len(projection.point) <= NEIGHBORS or not _is_scan(cloud, frame, spacing, config, projection):
        return None
    edges, scale = _image_edges(frame.image)
    if edges is None:
        return None
    row, column, jump = _depth_jumps(projection, scale)
    rows = []
    for down, right in [(0, 0), *EDGE_SHIFTS]:
        there = (row + down, column + right)
        inside = (there[0] >= 0) & (there[0] < edges.shape[0]) & (there[1] >= 0) & (there[1] < edges.shape[1])
        if float(jump[inside].sum()) < MIN_JUMPS:
            return None
        rows.append(correlation(edges[there[0][inside], there[1][inside]], jump[inside]))
    return torch.stack(rows)


def _is_scan(cloud: Cloud, frame: Frame, spacing: Tensor, config: VisibilityConfig, projection: Projection) -> bool:
    """Whether hardly any point hides another point. A cloud of many views also has the points behind the surface."""
    thin = replace(config, method="zbuffer", footprint=0.1)
    visible = visible_points(cloud.points, spacing, frame.intrinsics, frame.world_to_camera, frame.size, thin)
    return len(visible.point) >= MIN_VISIBLE * len(projection.point)


def _image_edges(image: Tensor) -> tuple[Tensor | None, float]:
    """Edge strength [h, w] relative to its surroundings (None for a blank image), and the scale of the resizing."""
    scale = SIDE / max(image.shape[1:])
    size = [max(1, round(side * scale)) for side in image.shape[1:]]
    small = torch.nn.functional.interpolate(image[None], size, mode="bilinear", antialias=True)
    edges = smooth(GradientBoundary(smoothing=1.0, contrast=8.0)(small)[None], BLUR)
    if float(edges.std()) < MIN_CONTRAST:
        return None, scale
    away = edges - smooth(edges, SURROUNDINGS)
    return (away / (smooth(away**2, SURROUNDINGS) + 1e-4).sqrt())[0, 0].double(), scale


def _depth_jumps(projection: Projection, scale: float) -> tuple[Tensor, Tensor, Tensor]:
    """Row and column halfway between points that are neighbours in the image, and the depth jump there, 0 to 1."""
    place = (np.stack([projection.v.numpy(), projection.u.numpy()], axis=1).astype(np.float64) + 0.5) * scale - 0.5
    first = np.arange(0, len(place), -(-len(place) // MAX_QUERIES))
    # The nearest neighbour of a point is the point itself, or a duplicate.
    distance, second = cKDTree(place).query(place[first], k=NEIGHBORS + 1, distance_upper_bound=REACH)
    near = np.isfinite(distance[:, 1:])
    first, second = np.repeat(first[:, None], NEIGHBORS, axis=1)[near], second[:, 1:][near]
    depth = np.log(projection.z.double().numpy())
    jump = np.clip((np.abs(depth[first] - depth[second]) - SMALLEST_JUMP) / JUMP_RANGE, 0, 1)
    row, column = np.floor((place[first] + place[second]) / 2 + 0.5).astype(np.int64).T
    return torch.from_numpy(row), torch.from_numpy(column), torch.from_numpy(jump)
