"""Nearest neighbours as a LiDAR sees them: by direction and by the ratio of ranges, not by metres.

The beams of a sweep lie far apart and the points of a beam close together, so that the nearest neighbours in space are
those along a point's own beam. By angles, points of the beams above and below are near as well.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint.neighbors import nearest_neighbors

#: Ranges below this count as this: at the sensor itself directions and logarithms mean nothing.
LEAST_RANGE = 1e-3


class Directions(NamedTuple):
    """Where points are seen from the sensor; z is up."""

    azimuth: Tensor  #: [N] float64 radians about z, in [-pi, pi], 0 = along x
    elevation: Tensor  #: [N] float64 radians, in [-pi/2, pi/2], 0 = level
    distance: Tensor  #: [N] float64 metres, on the level
    range: Tensor  #: [N] float64 metres, at least `LEAST_RANGE`


def directions(points: Tensor, sensor: Tensor | None = None) -> Directions:
    """Spherical coordinates of points.

    Args:
        points: [N, 3] metres, z up.
        sensor: [3] metres, where it stands; default: the origin.
    """
    x, y, z = _seen_from(points, sensor).unbind(1)
    distance = (x.square() + y.square()).sqrt()
    reach = (distance.square() + z.square()).sqrt().clamp(min=LEAST_RANGE)
    return Directions(torch.atan2(y, x), torch.atan2(z, distance), distance, reach)


def angular_neighbors(points: Tensor, count: int, azimuth_weight: float = 1.0, sensor: Tensor | None = None) -> Tensor:
    """The `count` nearest neighbours of each point in (c azimuth, elevation, ln range), nearest first.

    There the azimuth is a circle of radius c without a seam, and two azimuths are as far apart as its chord is long.

    Args:
        points: [N, 3] metres, z up.
        count: K >= 1; all others, where there are fewer.
        azimuth_weight: c; less reaches farther along a beam, more across beams.
        sensor: [3] metres; default: the origin.

    Returns:
        [N, K] int32, as :func:`torchjoint.neighbors.nearest_neighbors` has them.
    """
    seen = directions(points, sensor)
    circle = azimuth_weight * torch.stack([seen.azimuth.cos(), seen.azimuth.sin()], 1)
    place = torch.cat([circle, seen.elevation[:, None], seen.range.log()[:, None]], 1)
    return nearest_neighbors(place, count).indices


def _seen_from(points: Tensor, sensor: Tensor | None) -> Tensor:
    return points.double() if sensor is None else points.double() - sensor.double()
