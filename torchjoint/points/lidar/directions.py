"""Where a LiDAR sees points: directions and ranges."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

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


def _seen_from(points: Tensor, sensor: Tensor | None) -> Tensor:
    return points.double() if sensor is None else points.double() - sensor.double()
