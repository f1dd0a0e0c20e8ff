"""Recognises a scan of a LiDAR: by its rings, or by how its points depend on range."""

import math
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchjoint.runtime.threads import one_thread_per_operation
from torchjoint.scene.checks import as_points

#: Smallest range, metres; shorter ranges are set to it, because a range of 0 has no direction and no logarithm.
LEAST_RANGE = 1e-3


class Directions(NamedTuple):
    """Spherical coordinates of points. The sensor is at the origin, and z is up."""

    azimuth: Tensor  #: [N] float64 radians about z, in [-pi, pi], 0 = along x
    elevation: Tensor  #: [N] float64 radians, in [-pi/2, pi/2], 0 = horizontal
    distance: Tensor  #: [N] float64 metres, horizontal
    range: Tensor  #: [N] float64 metres, at least `LEAST_RANGE`


def directions(points: Tensor) -> Directions:
    """Spherical coordinates of points [N, 3], in metres, with the sensor at the origin and z up."""
    # One by one, columns take a tenth of the time that a transposed copy takes.
    x, y, z = (column.double().contiguous() for column in points.unbind(1))
    distance = (x.square() + y.square()).sqrt()
    span = (distance.square() + z.square()).sqrt()
    return Directions(torch.atan2(y, x), torch.atan2(z, distance), distance, span.clamp(min=LEAST_RANGE))


#: Number of windows of azimuth, of the whole turn.
WINDOWS = 72
#: Bins of elevation, degrees.
BIN = 0.02
#: Largest angle between two beams, degrees.
LARGEST_STEP = 2.4
#: Number of differences of elevation, in bins, at which pairs are counted: to twice the largest angle and some more.
NUM_LAGS = round(2.5 * LARGEST_STEP / BIN)
#: Width of the neighbourhood, degrees, whose mean density of points gives the expected number of pairs.
AROUND = 4.0
#: Smallest angle between two beams, in bins.
FIRST = 3
#: Elevations are measured at this share of the points. They are the farthest, because noise changes the elevation of
#: near points most. At least FAR_POINTS points are used, but at most the share MOST_SHARE.
FAR_SHARE, FAR_POINTS, MOST_SHARE = 0.25, 10_000, 0.5
#: Smallest density of pairs at the peak, and largest density at the dip; 1 is the density of independent elevations.
LEAST_PEAK, LARGEST_DIP = 1.25, 0.6
#: Smallest density at the peak, as a share of the density at 0. Rings repeat at equal steps, so both densities are
#: similar: in scans the share is .3 or more. Random clumps of points give a high density at 0 and a low peak.
LEAST_RECURRENCE = 0.15
#: The angle between two rings is that of the first peak whose height is at least this share of the highest peak.
PEAK_SHARE = 0.4
#: At twice the angle, within this share of it, is another peak; it has at least this share of the first one's height.
#: Scans have .7 or more. In other clouds peaks are random, or alone: both sides of a floor, seen from its own height.
SAME_STEP, REPEATED = 0.15, 0.6
#: Smallest expected number of pairs in a bin of differences: with fewer, chance alone makes peaks.
LEAST_PAIRS = 50.0
#: Smallest number of windows with points (8 windows are 40 degrees), and smallest number of points in such a window.
LEAST_WINDOWS, LEAST_IN_WINDOW = 8, 8
#: Smallest ratio of far to near ranges (95 % and 5 % quantiles): a sphere around the sensor is no scene.
LEAST_DEPTH = 1.5
#: Lengths that are a multiple of this have fast Fourier transforms.
FAST_LENGTH = 256
#: Smallest and largest number of rings. A depth image has more rows.
NUM_RINGS = (4, 160)


class Rings(NamedTuple):
    """The rings of a recognised scan."""

    step: float  #: radians between two neighbouring rings, where they are closest
    number: int  #: approximate number of rings, counted in the windows of azimuth


def find_rings(points: Tensor, seen: Directions | None = None) -> Rings | None:
    """Finds the rings of a scan of a turning LiDAR. None: the cloud is no such scan.

    Args:
        points: [N, 3] in any unit, z up, the sensor at the origin.
        seen: their directions, if they are known.
    """
    with torch.no_grad(), one_thread_per_operation():
        seen = seen or directions(as_points(points))
        share = min(MOST_SHARE, max(FAR_SHARE, FAR_POINTS / len(points)))
        near, least, far = _order_statistics(seen.range, (0.05, 1 - share, 0.95))
        if far < LEAST_DEPTH * near:
            return None
        used = torch.nonzero(seen.range >= least).flatten()
        window = ((seen.azimuth + math.pi) / (2 * math.pi) * WINDOWS).long().clamp(max=WINDOWS - 1)
        elevation = seen.elevation * (180 / math.pi)
        counts = _histograms(window[used], elevation[used])
        if int((counts.sum(1) >= LEAST_IN_WINDOW).sum()) < LEAST_WINDOWS:
            return None
        length = counts.shape[1] + NUM_LAGS  # differences do not wrap around
        length += -length % FAST_LENGTH
        found = torch.fft.rfft(torch.stack([counts, _smooth(counts)], dim=1), n=length)
        density = _pair_density((found * found.conj()).real.sum(0), counts.sum(), length)
        step = _ring_step(density)
        if step is None or _peak(density, 2 * step) < max(LEAST_PEAK, REPEATED * _peak(density, step)):
            return None
        number = _count_rings(window, elevation, step)
        return Rings(math.radians(step), number) if NUM_RINGS[0] <= number <= NUM_RINGS[1] else None


def _order_statistics(values: Tensor, shares: tuple[float, ...]) -> list[float]:
    places = [round(share * (len(values) - 1)) for share in shares]
    found = np.partition(values.numpy(), places)
    return [float(found[place]) for place in places]


def _histograms(window: Tensor, elevation: Tensor) -> Tensor:
    """[WINDOWS, B] float64, number of points in each bin of elevation."""
    bins = ((elevation - elevation.min()) / BIN).long()
    num_bins = int(bins.max()) + 1
    return torch.bincount(window * num_bins + bins, minlength=WINDOWS * num_bins).view(WINDOWS, -1).double()


def _smooth(counts: Tensor) -> Tensor:
    """The mean of each bin and of those around it."""
    half = round(AROUND / BIN / 2)
    total = torch.nn.functional.pad(counts, (half + 1, half)).cumsum(1)  # exact: they are whole numbers
    return (total[:, 2 * half + 1 :] - total[:, : -2 * half - 1]) / (2 * half + 1)


def _pair_density(power: Tensor, num_points: Tensor, length: int) -> Tensor:
    """Density of pairs [D] at each difference, in bins; 1 = as for independent elevations, 0 = too few pairs.

    Args:
        power: [2, F] sums over the windows, of their numbers of points and of the same smoothed.
        num_points: [] number of points.
        length: of the padded rows.
    """
    pairs, expected = torch.fft.irfft(power, n=length)[:, :NUM_LAGS]
    pairs[0] -= num_points  # a point is no pair with itself
    return torch.where(expected >= LEAST_PAIRS, pairs / expected.clamp(min=1.0), 0.0)


def _ring_step(density: Tensor) -> float | None:
    """Degrees between two rings: the first high peak behind a dip; None if there is none."""
    behind = density[FIRST : round(LARGEST_STEP / BIN)]
    lowest = behind.cummin(0).values
    is_peak = (behind >= max(LEAST_PEAK, LEAST_RECURRENCE * float(density[0]))) & (lowest <= LARGEST_DIP)
    if not bool(is_peak.any()):
        return None
    highest = float(behind[is_peak].max())
    first = int(torch.nonzero(is_peak & (behind >= PEAK_SHARE * highest))[0])
    # The peak's top, within half a step.
    top = first + int(behind[first : first + max(1, (first + FIRST) // 2)].argmax())
    return (FIRST + top) * BIN


def _peak(density: Tensor, angle: float) -> float:
    """The largest density at about this angle."""
    low, high = (round(angle * (1 + side * SAME_STEP) / BIN) for side in (-1, 1))
    return float(density[low : high + 1].max())


def _count_rings(window: Tensor, elevation: Tensor, step: float) -> int:
    """The 90 % quantile, over the windows, of the number of groups of elevations; gaps exceed half a step."""
    place = window * 1000 + elevation
    # Gaps are between cells of a quarter of a step, so only the lowest and the highest place of each are compared.
    row = ((elevation - elevation.min()) / (step / 4)).long()
    cell, inf = window * (int(row.max()) + 1) + row, torch.full((WINDOWS * (int(row.max()) + 1),), math.inf).double()
    low, high = inf.scatter_reduce(0, cell, place, "amin"), (-inf).scatter_reduce(0, cell, place, "amax")
    low, high = low[low < inf], high[low < inf]
    new = torch.ones_like(low, dtype=torch.bool)
    new[1:] = low[1:] - high[:-1] > step / 2
    of_window = torch.bincount(((low[new] + 500) / 1000).floor().long(), minlength=WINDOWS)
    return round(_order_statistics(of_window[of_window > 0].double(), (0.9,))[0])


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
MAX_DEPENDENCE = 0.38
#: Largest unevenness (:func:`_unevenness`): scans have .1 to .36, ten aligned sweeps in open places .57 and more.
LARGEST_UNEVENNESS = 0.45
#: Smallest and largest ratio of far ranges (95 % quantile) to the depth of low points below the sensor (5 % quantile of
#: heights). Scans of streets and halls have 10 to 100, rooms and table-tops at most 6. Where the floor is at z = 0, the
#: depth is its noise, and rooms have 400 and more.
REACH = (8.0, 250.0)


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
        if depth <= 0 or not REACH[0] <= far / depth <= REACH[1]:
            return math.inf
        return max(0.0, _growth(seen)) + _contradiction(seen, ordered)  # numbers that fall excuse no contradiction


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
    return values - (torch.bincount(row, weights=values * weight) / torch.bincount(row, weights=weight))[row]


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
        return self.rings is not None or (self.dependence is not None and self.dependence < MAX_DEPENDENCE)

    def __str__(self) -> str:
        if self.rings is not None:
            return f" of a turning LiDAR with about {self.rings.number} rings (certain)"
        if not self.is_scan:
            return ", no scan of a LiDAR recognised"
        sureness = "likely" if self.dependence is not None and self.dependence < MAX_DEPENDENCE / 2 else "perhaps"
        dependence = f"dependence on range {self.dependence:.2f} of {MAX_DEPENDENCE}"
        return f" of a LiDAR without clear rings ({sureness}: {dependence})"


def look_for_scan(points: Tensor) -> ScanSigns:
    """Looks for rings, and if there are none, for other signs that points [N, 3] were seen from near the origin."""
    rings = find_rings(points)
    return ScanSigns(rings, dependence_on_range(points) if rings is None else None)
