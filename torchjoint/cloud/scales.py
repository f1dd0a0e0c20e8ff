"""Step 3, method learned: the scales of a cloud, its noise and its spacing, measured at each point.

A model can only judge clouds of different sensors if distances are measured in multiples of the cloud's own noise and
spacing.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchjoint.cloud._vectors import dot
from torchjoint.cloud.neighbors import nearest_neighbors
from torchjoint.ops.internal import region_planes
from torchjoint.runtime.threads import all_threads, parallel_map

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
    rank = torch.tensor(NOISE_QUANTILE) * (values.shape[1] - 1)
    below = int(rank)
    return torch.lerp(ascending[:, below], ascending[:, math.ceil(rank)], rank - below)
