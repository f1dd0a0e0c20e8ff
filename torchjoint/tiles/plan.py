"""Cuts the plane into tiles along the cells of a survey.

Without a size, the whole plane is one tile. A tile that holds too many points, with its buffer, is cut across its
longer side into two tiles with about equally many points; these are cut again if necessary. So each tile fits into
memory, also if the density is uneven, and a small cloud is one tile.
"""

from __future__ import annotations

import math
import warnings
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from torchjoint.tiles.survey import Survey

#: A tile is at least this many buffers wide.
NARROWEST = 4


class Tile(NamedTuple):
    """A rectangle of cells: columns first[0] to end[0] - 1, rows first[1] to end[1] - 1."""

    first: tuple[int, int]
    end: tuple[int, int]


class Plan(NamedTuple):
    """The tiles, and the tile of each cell."""

    tiles: list[Tile]  #: those that hold points
    buffer: float  #: metres
    of_cell: npt.NDArray[np.int32]  #: [columns, rows] the tile of each cell; -1: no tile, because no points are near

    def neighbors(self, survey: Survey) -> list[tuple[int, int]]:
        """Pairs of tiles whose rectangles with buffers overlap; the lower number comes first."""
        low = np.array([tile.first for tile in self.tiles]) * survey.side - self.buffer
        high = np.array([tile.end for tile in self.tiles]) * survey.side + self.buffer
        pairs = []
        for one in range(len(self.tiles)):
            near = ((low[one] < high[one + 1 :]) & (low[one + 1 :] < high[one])).all(1)
            pairs += [(one, one + 1 + int(other)) for other in np.flatnonzero(near)]
        return pairs


def plan_tiles(survey: Survey, size: float | None, buffer: float, most_points: int) -> Plan:
    """Cuts the plane.

    Args:
        survey: of the cloud; if `size` is given, the survey's grid is aligned to it.
        size: side of the squares that are cut first, metres; None: one rectangle for the whole plane.
        buffer: width of the rim that a tile shares with its neighbours, metres.
        most_points: largest number of points of a tile with its buffer.

    Warns:
        UserWarning: a tile holds more than twice as many points, because it is too narrow to be cut.
    """
    sums = np.zeros(np.array(survey.counts.shape) + 1, np.int64)
    sums[1:, 1:] = survey.counts.cumsum(0).cumsum(1)
    rim, narrowest = math.ceil(buffer / survey.side), math.ceil(NARROWEST * buffer / survey.side)
    waiting, done = _squares(survey, size), []
    while waiting:
        tile = waiting.pop()
        if not _points(sums, tile):
            continue
        halves = _halves(sums, tile, narrowest) if _points(sums, tile, rim) > most_points else None
        if halves is None:
            done.append(tile)
        else:
            waiting += halves
    done.sort()
    largest = max(_points(sums, tile, rim) for tile in done)
    if largest > 2 * most_points:
        warnings.warn(
            f"a tile holds {largest} points and needs more memory: its halves would be narrower than {NARROWEST} "
            "buffers; choose a smaller --buffer",
            stacklevel=2,
        )
    of_cell = np.full(survey.counts.shape, -1, np.int32)
    for number, tile in enumerate(done):
        of_cell[tile.first[0] : tile.end[0], tile.first[1] : tile.end[1]] = number
    return Plan(done, buffer, of_cell)


def _squares(survey: Survey, size: float | None) -> list[Tile]:
    columns, rows = survey.counts.shape
    step = max(columns, rows) if size is None else round(size / survey.side)
    return [
        Tile((x, y), (min(x + step, columns), min(y + step, rows)))
        for x in range(0, columns, step)
        for y in range(0, rows, step)
    ]


def _points(sums: npt.NDArray[np.int64], tile: Tile, rim: int = 0) -> int:
    """The number of points in a tile and in a rim of so many cells around it."""
    (x0, y0), (x1, y1) = np.maximum(np.array(tile.first) - rim, 0), np.minimum(np.array(tile.end) + rim, sums.shape)
    x1, y1 = min(x1, sums.shape[0] - 1), min(y1, sums.shape[1] - 1)
    return int(sums[x1, y1] - sums[x0, y1] - sums[x1, y0] + sums[x0, y0])


def _halves(sums: npt.NDArray[np.int64], tile: Tile, narrowest: int) -> list[Tile] | None:
    """Cuts a tile in two across its longer side; None if the halves would be too narrow."""
    (x0, y0), (x1, y1) = tile
    axis = 0 if x1 - x0 >= y1 - y0 else 1
    first, end = tile.first[axis], tile.end[axis]
    places = np.arange(first + max(narrowest, 1), end - max(narrowest, 1) + 1)
    if not len(places):
        return None
    if axis == 0:
        before = sums[places, y1] - sums[places, y0] - (sums[x0, y1] - sums[x0, y0])
    else:
        before = sums[x1, places] - sums[x0, places] - (sums[x1, y0] - sums[x0, y0])
    cut = int(places[np.abs(2 * before - _points(sums, tile)).argmin()])
    if axis == 0:
        return [Tile((x0, y0), (cut, y1)), Tile((cut, y0), (x1, y1))]
    return [Tile((x0, y0), (x1, cut)), Tile((x0, cut), (x1, y1))]
