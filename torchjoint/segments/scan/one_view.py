"""Recognises a scan without clear rings: noise, solid-state patterns and several sensors hide them.

A sensor sends its rays without knowing what they hit. So in a scan, the number of points in a direction does not depend
on how far away things are there, and points of nearly the same direction mostly have similar ranges. In a map or a
fused cloud the points are about equally dense everywhere, so their number in a direction grows with the square of the
range; and behind a surface there are others, seen from elsewhere. Only angles and ratios of ranges are measured.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint.runtime.threads import one_thread_per_operation
from torchjoint.scene.checks import as_points
from torchjoint.segments.scan.directions import Directions, directions
from torchjoint.segments.scan.recognition import Rings, find_rings

#: Size of the cells in which points are counted, degrees of azimuth and elevation: several steps of any sensor.
CELL = (5.0, 2.0)
#: Smallest number of points in such a cell, of such cells, and smallest share of the points in them. With fewer points,
#: only the cells that happen to be full would count.
LEAST_POINTS, LEAST_CELLS, LEAST_SHARE = 8, 20, 0.5
#: Two points that follow each other in azimuth have nearly the same direction if they are in a row of elevations of
#: this height and at most this far apart, degrees.
ROW, BESIDE = 0.4, 0.5
#: The ranges of two points differ if the logarithm of their ratio exceeds this.
DIFFERENCE = 0.3
#: A scan has a smaller sum of growth and contradiction (:func:`dependence_on_range`). Scans of all kinds, noisy ones,
#: of two sensors, or with outliers, have at most .31; ten aligned sweeps along 20 m have .45, and rooms more than 1.
MOST = 0.38
#: Largest unevenness (:func:`_unevenness`): scans have .1 to .36, ten aligned sweeps in open places .57 and more.
LARGEST_UNEVENNESS = 0.45
#: Smallest ratio of far ranges (95 % quantile) to the depth of low points below the sensor (5 % quantile of heights).
#: Scans of streets and halls have 10 and more, rooms and table-tops at most 6.
LEAST_REACH = 8.0


def dependence_on_range(points: Tensor) -> float:
    """How much the points depend on range: about 0 in a scan, 1 to 3 in a map; inf: surely no scan.

    The sum of two numbers. Growth: the exponent of the range with which the number of points in a cell of directions
    grows, among cells of the same elevation. Contradiction: how often two points of nearly the same direction have
    different ranges, as a share of how often any two points have.

    Args:
        points: [N, 3] in any unit, z up, the sensor near the origin.

    Raises:
        ValueError, TypeError: naming the argument, what was expected and what came.
    """
    points = as_points(points)
    with torch.no_grad(), one_thread_per_operation():
        seen = directions(points)
        ordered = seen.range.log().sort().values
        far = math.exp(ordered[round(0.95 * (len(ordered) - 1))])
        depth = -float(points[:, 2].kthvalue(1 + len(points) // 20).values)
        if depth <= 0 or far < LEAST_REACH * depth:
            return math.inf
        return _growth(seen) + _contradiction(seen, ordered)


def _growth(seen: Directions) -> float:
    """Slope of the logarithm of the number of points over that of the range, within rows of cells; inf: no scan.

    It is no scan if there are too few cells, or if their numbers are uneven.
    """
    columns = round(360 / CELL[0]) + 1
    row = ((seen.elevation + math.pi / 2) / math.radians(CELL[1])).long()
    cell = row * columns + ((seen.azimuth + math.pi) / math.radians(CELL[0])).long()
    number = torch.bincount(cell)
    used = torch.nonzero(number >= LEAST_POINTS).flatten()
    reach = torch.bincount(cell, weights=seen.range.log())[used] / number[used]
    row, number = used // columns, number[used].double()
    if len(used) < LEAST_CELLS or float(number.sum()) < LEAST_SHARE * len(cell):
        return math.inf
    if _unevenness(number, row) > LARGEST_UNEVENNESS:
        return math.inf
    equal = torch.ones_like(number)
    reach, count = (_centered(values, row, equal) for values in (reach, number.log()))
    return float((reach * count).sum() / reach.square().sum().clamp(min=1e-9))


def _unevenness(number: Tensor, row: Tensor) -> float:
    """Mean deviation, over the points, of the logarithm of their cell's number of points from its mean in the row."""
    return float((_centered(number.log(), row, number).abs() * number).sum() / number.sum())


def _centered(values: Tensor, row: Tensor, weight: Tensor) -> Tensor:
    mean = torch.bincount(row, weights=values * weight) / torch.bincount(row, weights=weight)
    return values - mean[row]


def _contradiction(seen: Directions, ordered: Tensor) -> float:
    """Share of pairs of nearly the same direction whose ranges differ, over that of all pairs; inf: no such pairs."""
    row = (seen.elevation / math.radians(ROW)).floor()
    order = (row * 10 + seen.azimuth).argsort()
    together = (row[order].diff() == 0) & (seen.azimuth[order].diff() <= math.radians(BESIDE))
    if not bool(together.any()):
        return math.inf
    differ = (seen.range[order].log().diff().abs() > DIFFERENCE)[together].double().mean()
    farther = torch.searchsorted(ordered, ordered - DIFFERENCE).double().mean() / len(ordered)  # one way of two
    return float(differ / (2 * farther))


class ScanSigns(NamedTuple):
    """What tells whether a cloud is a scan."""

    rings: Rings | None  #: None: no rings are recognised
    dependence: float | None  #: see :func:`dependence_on_range`; None: not computed, because the rings tell enough

    @property
    def is_scan(self) -> bool:
        """Whether the cloud is a scan."""
        return self.rings is not None or (self.dependence is not None and self.dependence < MOST)

    def __str__(self) -> str:
        if self.rings is not None:
            return f" of a turning LiDAR with about {self.rings.number} rings (certain)"
        if not self.is_scan:
            return ", no scan of a LiDAR recognised"
        sureness = "likely" if self.dependence is not None and self.dependence < MOST / 2 else "perhaps"
        return f" of a LiDAR without clear rings ({sureness}: dependence on range {self.dependence:.2f} of {MOST})"


def look_for_scan(points: Tensor) -> ScanSigns:
    """Looks for rings, and if there are none, for other signs that points [N, 3] were seen from near the origin."""
    rings = find_rings(points)
    return ScanSigns(rings, dependence_on_range(points) if rings is None else None)
