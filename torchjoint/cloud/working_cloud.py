"""Step 3, method learned: the cloud that the steps work on; a cloud that is much denser than its noise is thinned.

Where points lie closer together than they are exact, neighbours tell little about the surface. The mean of the points
of a small cell is more exact than each of them, and there are fewer of them.
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
#: ... but not so large that fewer points than about this remain: small things would be lost, and the cloud is small.
LEAST_POINTS = 50_000
#: Cells narrower than this many spacings would hardly thin: the cloud is left as it is.
NARROWEST = 1.3
#: Sides of cells between a length and twice this length.
SIDES_PER_OCTAVE = 4
#: A cloud with more cells than this (most of them empty) is left as it is: they could not be numbered.
MOST_CELLS = 2.0**62


class WorkingCloud(NamedTuple):
    """The cloud that the steps work on."""

    cloud: Cloud  #: W points
    scales: Scales  #: of these
    of_point: Tensor | None  #: [N] int64, the working point of each given point; None: the given points themselves


def working_cloud(cloud: Cloud) -> WorkingCloud:
    """Measures the scales of a cloud, and thins the cloud if it is much denser than its noise.

    Args:
        cloud: points [N, 3], optional colours and normals.
    """
    scales = measure_scales(cloud.points)
    needed = float((NEIGHBORS_PER_NOISE * scales.noise / scales.spacing).median())
    # The mean of n points has 1 / sqrt(n) of their noise, and a cell f spacings wide has f^2 points. So noise /
    # spacing, and with it the neighbours that are needed, fall with the square of f.
    width = min(needed / WANTED_NEIGHBORS, len(cloud.points) / LEAST_POINTS) ** 0.5
    extent = (cloud.points.amax(0) - cloud.points.amin(0)).double()
    side = _rounded(width * float(scales.spacing.median()), float(extent.max()))
    if width < NARROWEST or float((extent / side + 1).prod()) > MOST_CELLS:
        return WorkingCloud(cloud, scales, None)
    of_point, thinned = cell_means(cloud, side)
    return WorkingCloud(thinned, measure_scales(thinned.points), of_point)


def _rounded(side: float, extent: float) -> float:
    """The side of a cell, rounded to the cloud's extent divided by a power of 2 ** (1 / SIDES_PER_OCTAVE).

    Else a change of the measured spacing by a millionth would move the borders of cells far from the grid's corner, and
    put many points into other cells.
    """
    if side <= 0 or extent <= 0:
        return side
    return extent * 2.0 ** (-round(SIDES_PER_OCTAVE * math.log2(extent / side)) / SIDES_PER_OCTAVE)


def cell_means(cloud: Cloud, side: float) -> tuple[Tensor, Cloud]:
    """One point for each cubic cell: the mean of the cell's points, colours and normals.

    Args:
        cloud: points [N, 3].
        side: of a cell, metres; the grid starts at the smallest coordinates of the cloud.

    Returns:
        [N] int64, the new point of each point, numbered in the order of the cells; and the cloud of the new points.

    Raises:
        ValueError: so many cells that they cannot be numbered.
    """
    points = cloud.points.double()
    scaled = ((points - points.amin(0)) / side).floor()
    width = scaled.amax(0) + 1
    if float(width.prod()) > MOST_CELLS:
        raise ValueError(f"side: cells of {side} m are too small to be numbered in a cloud this large")
    cell, width = scaled.long(), width.long()
    key, of_point = torch.unique((cell[:, 0] * width[1] + cell[:, 1]) * width[2] + cell[:, 2], return_inverse=True)
    return of_point, merged_points(cloud, of_point, len(key))
