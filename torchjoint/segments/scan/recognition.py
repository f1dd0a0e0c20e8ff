"""Recognises a scan of a turning LiDAR by its rings: beams of constant elevation, seen from one place.

In a narrow window of azimuth, elevations of two returns differ either hardly at all (one beam) or by at least the angle
between two beams; hardly any pair lies in between. No other cloud is like this. So the density of pairs of elevations,
by their difference, falls to a dip after 0 and rises again to a peak. The windows are narrow, because in real scans the
elevation of a beam changes a little over a turn. Only angles are measured: the unit of length does not matter.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint.runtime.threads import one_thread_per_operation
from torchjoint.scene.checks import as_points
from torchjoint.segments.scan.directions import directions

#: Number of windows of azimuth, of the whole turn.
WINDOWS = 72
#: Bins of elevation, degrees.
BIN = 0.02
#: Largest angle between two beams, degrees.
LARGEST_STEP = 2.4
#: Width of the neighbourhood, degrees, whose mean density pairs are compared with.
AROUND = 4.0
#: Smallest angle between two beams, in bins.
FIRST = 3
#: Elevations are measured at this share of the points, the farthest, because noise turns near points most; but at no
#: fewer points than FAR_POINTS, unless this is more than MOST_SHARE.
FAR_SHARE, FAR_POINTS, MOST_SHARE = 0.25, 10_000, 0.5
#: Smallest density of pairs at the peak and largest at the dip, where 1 is that of independent elevations.
LEAST_PEAK, LARGEST_DIP = 1.25, 0.6
#: Smallest density at the peak as a share of that at 0: rings recur, while clumps of points, one here and one there,
#: are denser in themselves than among each other. Scans have .3 and more.
LEAST_RECURRENCE = 0.15
#: The angle between two rings is that of the first peak which has this share of the highest one.
PEAK_SHARE = 0.4
#: The two halves of the scan have peaks at angles that differ by at most this share: other clouds have such peaks at
#: most by chance.
SAME_STEP = 0.15
#: Smallest expected number of pairs in a bin of differences: with fewer, chance alone makes peaks.
LEAST_PAIRS = 25.0
#: Smallest number of windows with points (40 degrees), and smallest number of points of such a window.
LEAST_WINDOWS, LEAST_IN_WINDOW = 8, 8
#: Smallest ratio of far to near ranges (95 % and 5 % quantiles): a sphere around the sensor is no scene.
LEAST_DEPTH = 1.5
#: Smallest and largest number of rings: the rows of a depth image are more.
NUM_RINGS = (4, 160)


class Rings(NamedTuple):
    """The rings of a recognised scan."""

    step: float  #: radians between two neighbouring rings, where they are closest
    number: int  #: of rings, about: as many as one window of azimuth shows


def find_rings(points: Tensor) -> Rings | None:
    """The rings of a scan of a turning LiDAR at the origin, z up; None: the cloud is no such scan.

    Args:
        points: [N, 3] in any unit.

    Raises:
        ValueError, TypeError: naming the argument, what was expected and what came.
    """
    points = as_points(points)
    with torch.no_grad(), one_thread_per_operation():
        seen = directions(points)
        share = min(MOST_SHARE, max(FAR_SHARE, FAR_POINTS / len(points)))
        near, least, far = _order_statistics(seen.range, (0.05, 1 - share, 0.95))
        if far < LEAST_DEPTH * near:
            return None
        used = seen.range >= least
        window = ((seen.azimuth + math.pi) / (2 * math.pi) * WINDOWS).long().clamp(max=WINDOWS - 1)
        elevation = seen.elevation * (180 / math.pi)
        counts = _histograms(window[used], elevation[used])
        if int((counts.sum(1) >= LEAST_IN_WINDOW).sum()) < LEAST_WINDOWS:
            return None
        step = _ring_step(_pair_density(counts))
        if step is None or not all(_has_step(_pair_density(half), step) for half in _halves(counts)):
            return None
        number = _count_rings(window, elevation, step)
        return Rings(math.radians(step), number) if NUM_RINGS[0] <= number <= NUM_RINGS[1] else None


def _order_statistics(values: Tensor, shares: tuple[float, ...]) -> list[float]:
    ordered = values.sort().values
    return [float(ordered[round(share * (len(ordered) - 1))]) for share in shares]


def _histograms(window: Tensor, elevation: Tensor) -> Tensor:
    """[WINDOWS, B] float64, number of points in each bin of elevation."""
    bins = ((elevation - elevation.min()) / BIN).long()
    num_bins = int(bins.max()) + 1
    return torch.bincount(window * num_bins + bins, minlength=WINDOWS * num_bins).view(WINDOWS, -1).double()


def _pair_density(counts: Tensor) -> Tensor:
    """[D] density of pairs at each difference, in bins; 1 = as if elevations were independent, 0 = too few pairs."""
    num_lags = round(LARGEST_STEP / BIN)
    half = round(AROUND / BIN / 2)
    smooth = torch.nn.functional.avg_pool1d(counts[:, None], 2 * half + 1, 1, half)[:, 0]
    pairs, expected = (_autocorrelation(values, num_lags) for values in (counts, smooth))
    pairs[0] -= counts.sum()  # a point is no pair with itself
    return torch.where(expected >= LEAST_PAIRS, pairs / expected.clamp(min=1.0), 0.0)


def _autocorrelation(rows: Tensor, num_lags: int) -> Tensor:
    """[num_lags], the sum over the rows of the products of entries so many places apart."""
    size = rows.shape[1] + num_lags
    power = torch.fft.rfft(rows, n=size).abs().square().sum(0)
    return torch.fft.irfft(power, n=size)[:num_lags]


def _ring_step(density: Tensor) -> float | None:
    """Degrees between two rings: the first high peak behind a dip; None if there is none."""
    lowest = density[FIRST:].cummin(0).values
    behind = density[FIRST:]
    least = max(LEAST_PEAK, LEAST_RECURRENCE * float(density[0]))
    is_peak = (behind >= least) & (lowest <= LARGEST_DIP)
    if not bool(is_peak.any()):
        return None
    highest = float(behind[is_peak].max())
    first = int(torch.nonzero(is_peak & (behind >= PEAK_SHARE * highest))[0])
    # The peak's top, within half a step.
    top = first + int(behind[first : first + max(1, (first + FIRST) // 2)].argmax())
    return (FIRST + top) * BIN


def _halves(counts: Tensor) -> tuple[Tensor, Tensor]:
    """The windows up to the one that completes half of the points, and the others."""
    done = counts.sum(1).cumsum(0)
    middle = int((done < done[-1] / 2).sum()) + 1
    return counts[:middle], counts[middle:]


def _has_step(density: Tensor, step: float) -> bool:
    """Whether there is a peak at about this angle, behind a dip."""
    low, high = (round(step * (1 + side * SAME_STEP) / BIN) for side in (-1, 1))
    dip = float(density[FIRST : max(low, FIRST + 1)].min())
    return dip <= LARGEST_DIP and float(density[low : high + 1].max()) >= LEAST_PEAK


def _count_rings(window: Tensor, elevation: Tensor, step: float) -> int:
    """Number of groups of elevations with gaps of more than half a step between them; 90 % quantile of the windows."""
    place = (window * 1000 + elevation).sort().values
    new = torch.ones(len(place), dtype=torch.bool)
    new[1:] = place.diff() > step / 2
    of_window = torch.bincount(((place[new] + 500) / 1000).floor().long(), minlength=WINDOWS)
    return round(_order_statistics(of_window[of_window > 0].double(), (0.9,))[0])
