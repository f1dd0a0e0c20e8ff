"""The pixels of a polygon."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

#: Rows of edges that are computed at a time.
_STEP = 1 << 20
#: Pixels of a window that are filled at a time.
_STRIP = 1 << 22


class Window:
    """A part of an image around a polygon: its first row and column, and its size (H, W)."""

    def __init__(self, corners: npt.NDArray[np.float64], size: tuple[int, int]) -> None:
        low = np.clip(np.ceil(corners.min(0)), 0, size[::-1])
        high = np.clip(np.floor(corners.max(0)) + 1, low, size[::-1])
        (self.column, self.row), (width, height) = low.astype(int).tolist(), (high - low).astype(int).tolist()
        self.size, self.image_width = (height, width), size[1]


def polygon_pixels(corners: npt.NDArray[np.float64], size: tuple[int, int]) -> npt.NDArray[np.int64]:
    """The pixels whose centres lie in a polygon, or on its edge, as indices row x W + column, ascending.

    A pixel is inside if a ray from it crosses an odd number of edges. Edges may cross each other. Time and memory grow
    with the polygon's window, not with the image.

    Args:
        corners: [C, 2] finite (x, y), pixels; integers are the centres of pixels.
        size: (H, W) of the image.
    """
    window = Window(corners, size)
    strip = max(1, _STRIP // max(1, window.size[1]))
    return np.concatenate(
        [np.empty(0, np.int64)]
        + [
            _strip_pixels(corners, window, row, min(strip, window.row + window.size[0] - row)) + row * size[1]
            for row in range(window.row, window.row + window.size[0], strip)
        ]
    )


def work_of(corners: npt.NDArray[np.float64], size: tuple[int, int]) -> tuple[int, int]:
    """What :func:`polygon_pixels` takes: the pixels of the polygon's window, and the rows of its edges there."""
    window = Window(corners, size)
    rows = _rows_of_edges(corners[:, 1] - window.row, window.size[0])[1]
    return window.size[0] * window.size[1], int(rows.sum())


def _strip_pixels(corners: npt.NDArray[np.float64], window: Window, start: int, height: int) -> npt.NDArray[np.int64]:
    """The pixels in some rows of the window; indices begin with the first of these rows."""
    width = window.size[1]
    crossed = np.zeros((height, width + 1), dtype=np.int32)
    covered = np.zeros((height, width + 1), dtype=np.int32)  # steps of the number of edges that lie on a pixel
    for row, x, low_x, high_x, counts in _edge_rows(corners - (window.column, start), height):
        first = np.clip(np.ceil(low_x), 0, width).astype(np.int64)
        end = np.clip(np.floor(high_x) + 1, first, width).astype(np.int64)
        # One index in place of two, and a number of the array's type, are ten times as fast.
        np.add.at(covered.reshape(-1), row * (width + 1) + first, np.int32(1))
        np.add.at(covered.reshape(-1), row * (width + 1) + end, np.int32(-1))
        # A row through a corner belongs to the edge below it alone; pixels to the right of the edge change sides.
        right = np.clip(np.ceil(x[counts]), 0, width).astype(np.int64)
        np.add.at(crossed.reshape(-1), row[counts] * (width + 1) + right, np.int32(1))
    inside = (np.cumsum(crossed[:, :width], axis=1) % 2 == 1) | (np.cumsum(covered[:, :width], axis=1) > 0)
    rows, columns = np.nonzero(inside)
    return rows * window.image_width + columns + window.column


def _edge_rows(corners: npt.NDArray[np.float64], height: int) -> Iterator[tuple[npt.NDArray[Any], ...]]:
    """For each row [n] that an edge crosses: the row, x there, from where to where the edge covers it, if it counts."""
    (x0, y0), (x1, y1) = corners.T, np.roll(corners, -1, axis=0).T
    high = np.maximum(y0, y1)
    start, count = _rows_of_edges(y0, height)
    ends = np.cumsum(count)
    for first in range(0, int(ends[-1]), _STEP):
        place = np.arange(first, min(first + _STEP, int(ends[-1])))
        edge = np.searchsorted(ends, place, side="right")
        row = place - (ends - count)[edge] + start[edge]
        flat = y0[edge] == y1[edge]
        rise, run = np.where(flat, 1, y1[edge] - y0[edge]), x1[edge] - x0[edge]
        x = x0[edge] + (row - y0[edge]) * (run / rise)
        column = np.round(x)
        exact = (column - x0[edge]) * rise == (row - y0[edge]) * run
        low_x = np.where(flat, np.minimum(x0[edge], x1[edge]), np.where(exact, column, np.inf))
        high_x = np.where(flat, np.maximum(x0[edge], x1[edge]), np.where(exact, column, -np.inf))
        yield row, x, low_x, high_x, ~flat & (row < high[edge])


def _rows_of_edges(y: npt.NDArray[np.float64], height: int) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """The first row [C] of each edge between corners, and the number of its rows, of `height` ones."""
    low, high = np.minimum(y, np.roll(y, -1)), np.maximum(y, np.roll(y, -1))
    start = np.clip(np.ceil(low), 0, height).astype(np.int64)
    return start, np.clip(np.floor(high) + 1, start, height).astype(np.int64) - start
