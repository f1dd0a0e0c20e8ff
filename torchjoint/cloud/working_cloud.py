"""Step 3, method learned: thins a cloud if its points are much denser than their noise.

If points are closer together than their noise, neighbours tell little about the surface. The mean of the points in a
small cell is more exact than each point, and there are fewer means than points.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint.cloud.local import merged_points
from torchjoint.cloud.scales import NEIGHBORS_PER_NOISE, Scales, measure_scales
from torchjoint.scene import Cloud

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
