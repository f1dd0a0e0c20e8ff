"""Step 3, method learned: noise and spacing of a cloud, which is thinned if it is much denser than its noise."""

import math
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchjoint.cloud.local import merged_points
from torchjoint.cloud.neighbors import nearest_neighbors
from torchjoint.cloud.normals import dot
from torchjoint.ops.internal import region_planes
from torchjoint.runtime.threads import all_threads, parallel_map
from torchjoint.scene import Cloud

#: Number of neighbours to which the plane of a point is fitted, and around which the noise is measured.
NEIGHBORS = 24
#: Smallest number of points to which a plane is fitted; with fewer points the residual comes from a horizontal plane.
MIN_POINTS = 6
#: The noise at a point is this quantile of the residuals around it. It is low, because creases cause large residuals.
NOISE_QUANTILE = 0.3
#: Normals are fitted to k = this x noise / spacing neighbours. The error of a normal is about
#: noise / (radius x sqrt(k)), and the radius of k neighbours grows with spacing x sqrt(k). So for a given error k is
#: proportional to noise / spacing.
NEIGHBORS_PER_NOISE = 160
#: Smallest and largest number of neighbours of a normal. Fewer are not robust; more round off small objects.
NORMAL_NEIGHBORS = (16, 64)
#: Smallest noise and spacing, in multiples of the cloud's median spacing. Both are divisors, and clouds without noise
#: exist.
SMALLEST = 1e-3
#: Number of points processed at a time, on one of the threads.
POINTS = 1 << 16


class Scales(NamedTuple):
    """The scales of a cloud."""

    noise: Tensor  #: [N] float32 metres, typical distance of the points to the surface, > 0
    spacing: Tensor  #: [N] float32 metres, mean distance to the four nearest neighbours, > 0
    normal_neighbors: int  #: number of neighbours for normals, 16 ... 64; more noise needs more


def measure_scales(points: Tensor) -> Scales:
    """Measures noise and spacing at each point, and derives the number of neighbours to which normals are fitted.

    The residual of a point is its distance to the plane of itself and its NEIGHBORS nearest neighbours. The noise at
    a point is a low quantile of the residuals of these neighbours.

    Args:
        points: [N, 3] float32 metres.
    """
    indices, spacing = nearest_neighbors(points, NEIGHBORS)
    few, many = NORMAL_NEIGHBORS
    if indices.shape[1] == 0:  # a single point
        return Scales(torch.ones_like(spacing), torch.ones_like(spacing), few)
    one_region, upwards = torch.zeros(len(points), dtype=torch.int64), torch.zeros_like(points)
    upwards[:, 2] = 1
    with all_threads():
        mean, normal = region_planes(points, indices.contiguous(), one_region, upwards, MIN_POINTS)
    residual = dot(points - mean, normal).abs()

    def noise_at(start: int) -> Tensor:
        return low_quantile(residual[indices[start : start + POINTS].long()])

    noise = torch.cat(parallel_map(noise_at, range(0, len(points), POINTS)))
    smallest = SMALLEST * float(spacing.median()) or torch.finfo(torch.float32).tiny
    noise, spacing = noise.clamp(min=smallest), spacing.clamp(min=smallest)
    needed = float((NEIGHBORS_PER_NOISE * noise / spacing).median())
    return Scales(noise, spacing, min(many, max(few, round(needed))))


def low_quantile(values: Tensor) -> Tensor:
    """The NOISE_QUANTILE of each row, [N, K] finite float32 -> [N], as torch.quantile interpolates it.

    torch.quantile takes eight times as long, because of its sort.
    """
    ascending = torch.from_numpy(np.sort(values.numpy(), axis=1))
    rank = torch.tensor(NOISE_QUANTILE, dtype=torch.float32) * (values.shape[1] - 1)
    below = int(rank)
    return torch.lerp(ascending[:, below], ascending[:, math.ceil(rank)], rank - below)


#: The cells are so large that normals of the thinned cloud need about this many neighbours ...
WANTED_NEIGHBORS = 8
#: ... but at least about this many points remain; otherwise small objects would be lost.
LEAST_POINTS = 50_000
#: If the cells are narrower than this many spacings, the cloud is not thinned, because few points would be removed.
NARROWEST = 1.3
#: Number of allowed cell sides between a length and twice this length.
SIDES_PER_OCTAVE = 4
#: A cloud with more cells than this (mostly empty ones) is not thinned, because int64 cannot number the cells.
MOST_CELLS = 2.0**62


class WorkingCloud(NamedTuple):
    """The cloud that the steps work on."""

    cloud: Cloud  #: W points
    scales: Scales  #: scales of these points
    of_point: Tensor | None  #: [N] int64, the working point of each given point; None: the given points themselves


def working_cloud(cloud: Cloud) -> WorkingCloud:
    """Measures the scales of a cloud, and thins the cloud if it is much denser than its noise.

    Args:
        cloud: points [N, 3], optional colours and normals.
    """
    scales = measure_scales(cloud.points)
    needed = float((NEIGHBORS_PER_NOISE * scales.noise / scales.spacing).median())
    # The mean of n points has 1 / sqrt(n) of their noise, and a cell that is f spacings wide has f^2 points. So noise /
    # spacing, and with it the number of neighbours that normals need, decrease with the square of f.
    width = min(needed / WANTED_NEIGHBORS, len(cloud.points) / LEAST_POINTS) ** 0.5
    extent = (cloud.points.amax(0) - cloud.points.amin(0)).double()
    side = _rounded(width * float(scales.spacing.median()), float(extent.max()))
    if width < NARROWEST or float((extent / side + 1).prod()) > MOST_CELLS:
        return WorkingCloud(cloud, scales, None)
    of_point, thinned = cell_means(cloud, side)
    return WorkingCloud(thinned, measure_scales(thinned.points), of_point)


def _rounded(side: float, extent: float) -> float:
    """The side of a cell, rounded to the cloud's extent divided by a power of 2 ** (1 / SIDES_PER_OCTAVE).

    Without rounding, a tiny change of the measured spacing would move the borders of cells far from the grid's corner,
    and many points would change their cells.
    """
    if side <= 0 or extent <= 0:
        return side
    return extent * 2.0 ** (-round(SIDES_PER_OCTAVE * math.log2(extent / side)) / SIDES_PER_OCTAVE)


def cell_means(cloud: Cloud, side: float) -> tuple[Tensor, Cloud]:
    """One point for each cubic cell: the mean of the cell's points, colours and normals.

    Args:
        cloud: points [N, 3].
        side: side of a cell, metres; the grid starts at the smallest coordinates of the cloud.

    Returns:
        [N] int64, the new point of each point, numbered in the order of the cells; and the cloud of the new points.
    """
    points = cloud.points.double()
    cell = ((points - points.amin(0)) / side).floor().long()
    width = cell.amax(0) + 1
    key, of_point = torch.unique((cell[:, 0] * width[1] + cell[:, 1]) * width[2] + cell[:, 2], return_inverse=True)
    return of_point, merged_points(cloud, of_point, len(key))
