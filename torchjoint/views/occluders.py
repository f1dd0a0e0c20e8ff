"""Step 4, method learned: lines across occluders.

Follow a row or a column of an image. Where the depth falls by a step and later rises by a step, an occluder lies
between the ends of a line.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint.runtime.groups import best_of_groups
from torchjoint.views.visibility import Visible

#: Smallest depth step from an occluder to the surface behind it: a share of the depth, but at least a multiple of the
#: noise.
DEPTH_STEP, STEP_IN_NOISE = 0.03, 4.0
#: Side of the cells along which lines run, in mean distances between points in the image.
CELL = 1.5
#: Side of the squares, pixels, that measure the area of the visible points in the image.
SQUARE = 8


class CoarseZBuffer(NamedTuple):
    """The nearest visible points of a frame, in cells of some pixels."""

    cell: int  #: side of the cells, pixels
    point: Tensor  #: [h, w] int64, index of the nearest visible point in each cell; -1 = no point

    @classmethod
    def of(cls, visible: Visible) -> CoarseZBuffer:
        """Makes the cells; of equally near points the first counts."""
        cell = _cell_size(visible)
        row, column = visible.row // cell, visible.column // cell
        height, width = int(row.max()) + 1, int(column.max()) + 1
        point, _ = best_of_groups(row * width + column, torch.arange(len(visible.z)), -visible.z, height * width)
        return cls(cell, point.view(height, width))


def lines_across(visible: Visible, noise: Tensor) -> Tensor:
    """The points at the two ends of each line across an occluder, along the rows and the columns of an image.

    Args:
        visible: the visible points of an image.
        noise: [N] metres, noise of the points of the cloud.

    Returns:
        [2, V] int64 points.
    """
    if not len(visible.point):
        return torch.empty(2, 0, dtype=torch.int64)
    nearest = CoarseZBuffer.of(visible).point
    of_noise = STEP_IN_NOISE * noise[visible.point]
    return visible.point[torch.cat([_ends_of_gaps(grid, visible.z, of_noise) for grid in (nearest, nearest.T)], 1)]


def _cell_size(visible: Visible) -> int:
    """The side of the cells, pixels, from the mean distance of the visible points in the image."""
    row, column = visible.row // SQUARE, visible.column // SQUARE
    width = int(column.max()) + 1
    is_seen = torch.zeros((int(row.max()) + 1) * width, dtype=torch.bool)
    is_seen[row * width + column] = True
    return max(1, math.ceil(CELL * math.sqrt(int(is_seen.sum()) * SQUARE * SQUARE / len(visible.point))))


def _ends_of_gaps(grid: Tensor, z: Tensor, of_noise: Tensor) -> Tensor:
    """Ends [2, V] of the gaps along the rows of a grid [h, w] of visible points; empty cells (-1) are skipped."""
    row, _ = torch.nonzero(grid >= 0, as_tuple=True)
    point = grid[grid >= 0]
    falls, rises = _steps(row, point, z, of_noise)
    # Cells that contain points of both surfaces have depths between the two; they are skipped.
    mixed = (falls[:-1] & falls[1:]) | (rises[:-1] & rises[1:])
    kept = torch.nn.functional.pad(~mixed, (1, 1), value=True)[: len(row)]
    row, point = row[kept], point[kept]
    falls, rises = _steps(row, point, z, of_noise)
    fall, rise = _matched(row, falls, rises)
    first, last = fall + 1, rise  # of the occluder
    # Both ends and the occluder are at least two cells long.
    smooth = torch.nn.functional.pad((row[1:] == row[:-1]) & ~falls & ~rises, (0, 1))  # to the next cell
    long = (fall > 0) & smooth[fall - 1] & smooth[rise + 1] & (last > first)
    one, other, in_front = point[fall], point[rise + 1], torch.maximum(z[point[first]], z[point[last]])
    step = torch.maximum(_step(z, of_noise, one), _step(z, of_noise, other))
    return torch.stack([one, other])[:, long & (in_front < torch.minimum(z[one], z[other]) - step)]


def _steps(row: Tensor, point: Tensor, z: Tensor, of_noise: Tensor) -> tuple[Tensor, Tensor]:
    """Where the depth falls by a step, and where it rises by a step, from each of n cells to the next: [n - 1] bool."""
    change = z[point[1:]] - z[point[:-1]]
    # The farther of the two points determines the smallest step: its surface may be hidden.
    is_step = change.abs() > _step(z, of_noise, torch.where(change > 0, point[1:], point[:-1]))
    is_step &= row[1:] == row[:-1]
    return is_step & (change < 0), is_step & (change > 0)


def _step(z: Tensor, of_noise: Tensor, point: Tensor) -> Tensor:
    return torch.maximum(DEPTH_STEP * z[point], of_noise[point])


def _matched(row: Tensor, falls: Tensor, rises: Tensor) -> tuple[Tensor, Tensor]:
    """Matches falls and rises like parentheses: the last cell before each matched fall, and rise; [V] int64 each."""
    event = torch.nonzero(falls | rises).squeeze(1)
    opens = falls[event]
    level = torch.where(opens, 1, -1).cumsum(0) - opens.long()
    order = torch.argsort(level, stable=True)
    order = order[torch.argsort(row[event][order], stable=True)]
    before, after = order[:-1], order[1:]
    together = (row[event[before]] == row[event[after]]) & (level[before] == level[after])
    closed = together & opens[before] & ~opens[after]
    return event[before[closed]], event[after[closed]]
