"""First pass over a cloud: counts its points in the cells of a grid, and finds the range of its colours."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from torchjoint.datasets.files.las import LasPoints, las_points, open_las
from torchjoint.scene.cloud import full_brightness

#: Mean number of points in a cell, and most cells: small enough to cut tiles along cells, and few enough for memory.
POINTS, MOST_CELLS = 100, 4_000_000


class Survey(NamedTuple):
    """The distribution of a cloud's points."""

    num_points: int
    origin: npt.NDArray[np.float64]  #: [3] metres, the lower corner of the grid, and the lowest height
    side: float  #: of a cell, metres
    counts: npt.NDArray[np.int64]  #: [columns, rows] points in each cell
    whites: tuple[int, ...] | None  #: the colour value of full brightness of each file; None: there are no colours

    def cells(self, xy: npt.NDArray[np.float64]) -> npt.NDArray[np.int64]:
        """The column and row [n, 2] of the cell of each position [n, 2], or of the nearest cell if it is outside."""
        cell = np.floor((xy - self.origin[:2]) / self.side)
        return cell.clip(0, np.array(self.counts.shape) - 1).astype(np.int64)

    def spacing(self) -> float:
        """The typical distance of neighbouring points, metres: from the median density of the occupied cells."""
        return self.side / float(np.median(self.counts[self.counts > 0])) ** 0.5


def read_points(files: Sequence[Path], whites: Sequence[int] | None = None) -> Iterator[tuple[int, LasPoints]]:
    """Yields the points of all files in their order, in parts; with each part, the number of its first point.

    Args:
        files: of the cloud.
        whites: of :class:`Survey`; colours then have 16 bits in all files.

    Raises:
        FileNotFoundError, ValueError: the message names the file and its error.
    """
    first = 0
    for number, path in enumerate(files):
        with open_las(path) as reader:
            for points in las_points(reader, path):
                if whites is not None and points.rgb is not None:
                    points = points._replace(rgb=points.rgb * np.uint16(65535 // whites[number]))
                if not np.isfinite(points.xyz).all():
                    raise ValueError(f"{path}: expected finite coordinates, got NaN or infinite ones")
                yield first, points
                first += len(points.xyz)


def survey(files: Sequence[Path], align: float | None = None) -> Survey:
    """Counts the points of a cloud in cells.

    The grid covers the box that the headers give. If this box is much too large, the points are counted again.

    Args:
        files: of the cloud.
        align: metres; the grid starts at a multiple of this length, which is itself a multiple of the cells' side.

    Raises:
        FileNotFoundError, ValueError: the message names the file and its error.
    """
    num_points, low, high = _bounds(files)
    for _ in range(2):
        grid = _grid(num_points, low, high, align)
        counted, true_low, true_high = _count(files, grid)
        if np.prod(true_high[:2] - true_low[:2] + grid.side) > 0.25 * np.prod(grid.counts.shape) * grid.side**2:
            break
        low, high = true_low, true_high
    return counted._replace(origin=np.array([*counted.origin[:2], math.floor(true_low[2])]))


def _bounds(files: Sequence[Path]) -> tuple[int, npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """The number of points, and the lowest and highest corner [3] of their box, according to the headers."""
    lows, highs, num_points = [], [], 0
    for path in files:
        with open_las(path) as reader:
            lows.append(reader.header.mins)
            highs.append(reader.header.maxs)
            num_points += reader.header.point_count
    low, high = np.min(lows, axis=0), np.max(highs, axis=0)
    if not (np.isfinite(low).all() and np.isfinite(high).all() and (low <= high).all()):
        low, high = np.zeros(3), np.zeros(3)  # all points are counted in one cell, then again in a proper grid
    return num_points, low, high


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
    shape = np.floor((high[:2] - origin) / side).astype(np.int64) + 1
    return Survey(0, np.array([*origin, low[2]]), side, np.zeros(tuple(shape), np.int64), None)


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
        warnings.warn(
            f"{len(bare)} of {len(files)} files have no colours, so those of the others are not read: {bare[0]}"
            f"{', ...' if len(bare) > 1 else ''}",
            stacklevel=4,
        )
    whites = None if bare else tuple(int(full_brightness(value, 65535)) for value in largest.values())
    return grid._replace(num_points=num_points, counts=counts.reshape(grid.counts.shape), whites=whites), low, high
