"""Step 6, method scan: tests whether something rises from points. This separates objects from ground."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torchjoint.runtime.threads import parallel_map
from torchjoint.segments.scan.directions import Directions

#: Width of a cell in azimuth, radians (1 degree). Its length is about this share of its distance from the sensor.
CELL = math.radians(1.0)

#: Metres. A point higher than this above another one hangs over it (tree crowns, signs) and does not rise from it.
OVERHANG = 2.5

#: Number of points that are tested at a time, on one thread.
BLOCK = 1 << 13

#: Larger than any height, metres: one sorted tensor holds all cells, one after the other, at offsets of FAR.
FAR = 1e4


def something_rises(
    seen: Directions, height: Tensor, which: Tensor, object_height: float, used: Tensor | None = None
) -> Tensor:
    """Whether something rises from points: whether a higher point lies in the same cell or in one of the 8 around it.

    The higher point must be more than `object_height` and less than `OVERHANG` above the point. The cells divide the
    plane by azimuth and by the logarithm of the horizontal distance.

    Args:
        seen: directions of N points.
        height: [N] float64 metres, above any reference.
        which: [M] int64, the points to test.
        object_height: metres.
        used: [N] bool, the points that may be the higher ones; None: all.

    Returns:
        [M] bool.
    """
    num_columns = round(2 * math.pi / CELL)
    column = ((seen.azimuth + math.pi) / (2 * math.pi) * num_columns).long() % num_columns
    ring = (seen.distance.clamp(min=1e-3).log() / CELL).floor().long()
    ring = ring - ring.min() + 1
    height = height.clamp(-FAR / 4, FAR / 4)
    rows = int(ring.max()) + 2
    place = (column * rows + ring) * FAR + height
    place = (place if used is None else place[used]).sort().values

    def rise(some: Tensor) -> Tensor:
        rises, low = torch.zeros(len(some), dtype=torch.bool), height[some]
        for side in (-1, 0, 1):
            beside = (column[some] + side) % num_columns * rows
            for away in (-1, 0, 1):
                start = (beside + ring[some] + away) * FAR + low
                found = torch.searchsorted(place, start + object_height, right=True).clamp(max=len(place) - 1)
                over = place[found] - start
                rises |= (over > object_height) & (over < OVERHANG)
        return rises

    return torch.cat(parallel_map(rise, which.split(BLOCK)))
