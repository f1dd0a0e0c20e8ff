"""Cuts the plane into tiles along the cells of a survey.

Without a size, the whole plane is one tile. A tile that holds too many points, with its buffer, is cut across its
longer side into two tiles with about equally many points; these are cut again if necessary. So each tile fits into
memory, also if the density is uneven, and a small cloud is one tile.
"""

import math
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import torch

from torchjoint.datasets.files.columns import COLORS, NORMALS, PACKED, plain
from torchjoint.datasets.files.las import LasPoints, epsg_of, las_points, open_las, tell_unit
from torchjoint.runtime import bounds
from torchjoint.scene.checks import LARGEST_COORDINATE, check_largest, tell_degrees
from torchjoint.scene.cloud import full_brightness

#: Mean number of points in a cell, and most cells: small enough to cut tiles along cells, and few enough for memory.
POINTS, MOST_CELLS = 100, 4_000_000
#: Of files whose boxes and spacings differ by more than this, one has another unit. Files between which a hole is so
#: many times as wide as the largest file are no one cloud.
OTHER_UNIT, HOLE = 300, 300
#: What :func:`torchjoint.datasets.files.las.read_las` takes for colours and normals.
READ = {*PACKED, *(name for names in (*COLORS, *NORMALS) for name in names)}


class Survey(NamedTuple):
    """The distribution of a cloud's points."""

    num_points: int
    origin: npt.NDArray[np.float64]  #: [3] metres, the lower corner of the grid, and the lowest height
    side: float  #: of a cell, metres
    counts: npt.NDArray[np.int64]  #: [columns, rows] points in each cell
    whites: tuple[int, ...] | None  #: the colour value of full brightness of each file; None: there are no colours

    def cells(self, xy: npt.NDArray[np.float64]) -> npt.NDArray[np.int64]:
        """The column and row [n, 2] of the cell of each position [n, 2], or of the nearest cell if it is outside."""
        return np.floor((xy - self.origin[:2]) / self.side).clip(0, np.array(self.counts.shape) - 1).astype(np.int64)

    def spacing(self) -> float:
        """The typical distance of neighbouring points, metres: from the median density of the occupied cells."""
        return self.side / float(np.median(self.counts[self.counts > 0])) ** 0.5


def read_points(files: Sequence[Path], whites: Sequence[int] | None = None) -> Iterator[tuple[int, LasPoints]]:
    """Yields the points of all files in their order, in parts; with each part, the number of its first point.

    Args:
        files: of the cloud.
        whites: of :class:`Survey`; colours then have 16 bits in all files.
    """
    first = 0
    for number, path in enumerate(files):
        with open_las(path) as reader:
            for points in las_points(reader, path):
                if whites is not None and points.rgb is not None:
                    points = points._replace(rgb=points.rgb * np.uint16(65535 // whites[number]))
                if not np.isfinite(points.xyz).all():
                    raise ValueError(f"{path}: expected finite coordinates, got NaN or infinite ones")
                check_largest(torch.from_numpy(points.xyz), str(path))
                yield first, points
                first += len(points.xyz)


def survey(files: Sequence[Path], align: float | None = None) -> Survey:
    """Counts the points of a cloud in cells.

    The grid covers the box that the headers give. If this box is much too large, or points are not in it, as if it is
    all zeros, the points are counted again.

    Args:
        files: of the cloud.
        align: metres; the grid starts at a multiple of this length, which is itself a multiple of the cells' side.
    """
    num_points, low, high = _bounds(files)
    for _ in range(2):
        grid = _grid(num_points, low, high, align)
        counted, true_low, true_high = _count(files, grid)
        size, rim = np.array(grid.counts.shape) * grid.side, grid.origin[:2] - grid.side  # some boxes are rounded
        is_inside = (true_low[:2] >= rim).all() and (true_high[:2] <= rim + size + 2 * grid.side).all()
        if is_inside and np.prod(true_high[:2] - true_low[:2] + grid.side) > 0.25 * np.prod(size):
            break
        low, high = true_low, true_high
    return counted._replace(origin=np.array([*counted.origin[:2], math.floor(true_low[2])]))


def _bounds(files: Sequence[Path]) -> tuple[int, npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """The number of points, and the lowest and highest corner [3] of their box, according to the headers."""
    boxes, with_feet = np.zeros((len(files), 7)), []
    if len(systems := {epsg_of(path) for path in files} - {None}) > 1:
        codes = ", ".join(f"EPSG:{code}" for code in sorted(filter(None, systems)))
        warnings.warn(f"{files[0].parent}: coordinates of {codes} are taken as those of one system", stacklevel=4)
    for path, box in zip(files, boxes, strict=True):
        with open_las(path) as reader:
            with_feet.append(tell_unit(reader, path))
            box[:] = *reader.header.mins, *reader.header.maxs, reader.header.point_count
            extra = {*reader.header.point_format.extra_dimension_names} - {"red", "green", "blue"}
            if left := sorted(name for name in extra if plain(name) in READ):
                warnings.warn(f"{path}: {', '.join(left)}: not used in tiles; -o OUT.npy uses them", stacklevel=4)
    if len(systems) > 1 and any(with_feet) and not all(with_feet):
        one, other = (files[with_feet.index(has_feet)] for has_feet in (True, False))
        raise ValueError(f"{one}: expected the unit of the other files, got feet; {other} has none")
    lows, highs = boxes[:, :3], boxes[:, 3:6]
    right = np.flatnonzero((lows < highs).all(1) & (np.abs(boxes[:, :6]) <= LARGEST_COORDINATE).all(1))
    if len(np.unique(boxes[right, :6], axis=0)) < len(right):
        warnings.warn(f"{files[0].parent}: two files have the same box; are their points there twice?", stacklevel=4)
    if len(right) > 1:
        _tell_misfit([files[one] for one in right.tolist()], boxes[right])
    low, high = np.min(lows, axis=0), np.max(highs, axis=0)
    if not ((np.abs([low, high]) <= LARGEST_COORDINATE).all() and (low <= high).all()):
        low, high = np.zeros(3), np.zeros(3)  # all points are counted in one cell, then again in a proper grid
    tell_degrees(torch.from_numpy(np.stack([low, high])), str(files[0]))
    return int(boxes[:, 6].sum()), low, high


def _tell_misfit(files: Sequence[Path], boxes: npt.NDArray[np.float64]) -> None:
    """Warns if a file seems to have another unit or origin than the others; boxes [F, 7]: corners, number of points."""
    low, high, side = boxes[:, :2], boxes[:, 3:5], (boxes[:, 3:5] - boxes[:, :2]).max(1)
    # A scrap of a tile is small, and a sparse file has few points. In another unit, a file differs in both alike.
    sizes = np.log10(np.stack([side, side / np.sqrt(boxes[:, 6])]))
    ratio = sizes - np.quantile(sizes, 0.5, axis=1, method="lower", keepdims=True)
    misfit = int(np.where(ratio.prod(0) > 0, np.abs(ratio).min(0), 0).argmax())
    if abs(ratio[:, misfit]).min() > math.log10(OTHER_UNIT):
        told = f"box and spacing of its points are about {10 ** ratio[0, misfit].round():g} times those of other files"
        warnings.warn(f"{files[misfit]}: {told}; has it another unit?", stacklevel=5)
    for axis in (0, 1):
        order = low[:, axis].argsort(kind="stable")
        holes = low[order[1:], axis] - np.maximum.accumulate(high[order, axis])[:-1]
        if holes.max() > HOLE * side.max():
            one, other = (files[index] for index in sorted(order[holes.argmax() :][:2]))
            told = f"{one} and {other} are {holes.max() / 1000:.0f} km apart"
            warnings.warn(f"{told}; have they another unit or origin?", stacklevel=5)
            break


def _grid(num_points: int, low: npt.NDArray[np.float64], high: npt.NDArray[np.float64], align: float | None) -> Survey:
    """An empty grid."""
    extent = np.maximum(high - low, 1e-3)[:2]
    cells = min(max(num_points / POINTS, 1), MOST_CELLS)
    side = max(float(extent.prod() / cells) ** 0.5, float(extent.max()) / cells, 1e-3)
    step = side
    if align is not None:
        side = align / max(1, math.floor(align / side))
        step = align
    origin = np.floor(low[:2] / step) * step
    shape = np.floor((high[:2] - origin) / side) + 1
    bounds.check(shape.prod(), 32 * MOST_CELLS, "cells, of the cloud or of one tile", f"tile: {align} m")
    return Survey(0, np.array([*origin, low[2]]), side, np.zeros(shape.astype(np.int64), np.int64), None)


def _count(files: Sequence[Path], grid: Survey) -> tuple[Survey, npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """The grid with the number of points in each cell, and the corners of the box of the points."""
    counts, num_points, largest = np.zeros(grid.counts.size, np.int64), 0, dict.fromkeys(files, 0)
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for path, (xyz, rgb) in ((one, points) for one in files for _, points in read_points([one])):
        cell = grid.cells(xyz[:, :2])
        counts += np.bincount(cell[:, 0] * grid.counts.shape[1] + cell[:, 1], minlength=len(counts))
        low, high = np.minimum(low, xyz.min(0)), np.maximum(high, xyz.max(0))
        num_points += len(xyz)
        largest[path] = max(largest[path], 0 if rgb is None else int(rgb.max()))
    bare = [path for path, value in largest.items() if not value]
    if 0 < len(bare) < len(files):
        told = f"{len(bare)} of {len(files)} files have no colours, so those of the others are not read"
        warnings.warn(f"{told}: {bare[0]}{', ...' if len(bare) > 1 else ''}", stacklevel=4)
    whites = None if bare else tuple(int(full_brightness(value, 65535)) for value in largest.values())
    return grid._replace(num_points=num_points, counts=counts.reshape(grid.counts.shape), whites=whites), low, high


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
        told = f"a tile holds {largest} points and needs more memory: its halves would be narrower than {NARROWEST}"
        warnings.warn(f"{told} buffers; choose a smaller --buffer", stacklevel=2)
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
    is_wide = x1 - x0 >= y1 - y0
    along, (first, low), (end, high) = (sums, *tile) if is_wide else (sums.T, (y0, x0), (y1, x1))
    places = np.arange(first + max(narrowest, 1), end - max(narrowest, 1) + 1)
    if not len(places):
        return None
    before = along[places, high] - along[places, low] - (along[first, high] - along[first, low])
    cut = int(places[np.abs(2 * before - _points(sums, tile)).argmin()])
    if is_wide:
        return [Tile((x0, y0), (cut, y1)), Tile((cut, y0), (x1, y1))]
    return [Tile((x0, y0), (x1, cut)), Tile((x0, cut), (x1, y1))]
