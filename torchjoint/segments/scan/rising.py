"""Step 6, method scan: tests whether something rises from points. This separates objects from ground."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torchjoint.ops.something_rises import something_rises as ops_something_rises
from torchjoint.runtime.threads import all_threads
from torchjoint.segments.scan.directions import Directions

#: Width of a cell in azimuth, radians (1 degree). Its length is about this share of its distance from the sensor.
CELL = math.radians(1.0)

#: Metres. A point higher than this above another one hangs over it (tree crowns, signs) and does not rise from it.
OVERHANG = 2.5


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
    row = (seen.distance.clamp(min=1e-3).log() / CELL).floor().long()
    row -= row.min()
    used = torch.ones_like(column, dtype=torch.bool) if used is None else used
    with all_threads():
        return ops_something_rises(
            column, row, height, used, which, num_columns, int(row.max()) + 1, object_height, OVERHANG
        )
