"""Step 6, method scan: directions and ranges of points as a LiDAR sees them."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

#: Smallest range, metres; shorter ranges are set to it, because a range of 0 has no direction and no logarithm.
LEAST_RANGE = 1e-3


class Directions(NamedTuple):
    """Spherical coordinates of points relative to the sensor; z is up."""

    azimuth: Tensor  #: [N] float64 radians about z, in [-pi, pi], 0 = along x
    elevation: Tensor  #: [N] float64 radians, in [-pi/2, pi/2], 0 = horizontal
    distance: Tensor  #: [N] float64 metres, horizontal
    range: Tensor  #: [N] float64 metres, at least `LEAST_RANGE`


def directions(points: Tensor, sensor: Tensor | None = None) -> Directions:
    """Spherical coordinates of points.

    Args:
        points: [N, 3] metres, z up.
        sensor: [3] metres, position of the sensor; default: the origin.
    """
    x, y, z = _seen_from(points, sensor).unbind(1)
    distance = (x.square() + y.square()).sqrt()
    reach = (distance.square() + z.square()).sqrt().clamp(min=LEAST_RANGE)
    return Directions(torch.atan2(y, x), torch.atan2(z, distance), distance, reach)


def _seen_from(points: Tensor, sensor: Tensor | None) -> Tensor:
    return points.double() if sensor is None else points.double() - sensor.double()
