"""Masks of COCO: run lengths and polygons."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from torchjoint.runtime import bounds

#: Most characters of a compressed number: 35 bits are more than an image has pixels.
_DIGITS = 7


def rle_pixels(rle: Mapping[str, Any], name: str = "segmentation") -> tuple[tuple[int, int], npt.NDArray[np.int64]]:
    """The size (H, W) of run lengths, and the pixels inside as indices row x W + column, in any order.

    Args:
        rle: ``size`` [H, W], and ``counts``: a list of numbers, or COCO's compressed string.
        name: name of the mask in messages.

    Raises:
        ValueError, TypeError: naming the entry; also if the sum of the counts is not H x W.

    >>> rle_pixels({"size": [2, 3], "counts": [1, 2, 3]})
    ((2, 3), array([1, 3]))
    """
    if not isinstance(rle, Mapping) or not {"size", "counts"} <= set(rle):
        raise ValueError(f"{name}: expected run lengths with size and counts, got {_described(rle)}")
    height, width = _size(rle["size"], f"{name}'s size")
    counts = rle["counts"]
    if isinstance(counts, (str, bytes)):
        counts = _uncompressed(counts, f"{name}'s counts").tolist()
    elif not isinstance(counts, Sequence) or not all(_is_integer(count) for count in counts):
        raise TypeError(f"{name}'s counts: expected a string or a list of integers, got {_described(counts)}")
    if any(count < 0 for count in counts):
        raise ValueError(f"{name}'s counts: expected numbers >= 0, got {min(counts)}")
    if sum(counts) != height * width:
        expected = f"a sum of {height} x {width} = {height * width} pixels"
        raise ValueError(f"{name}'s counts: expected {expected}, got {sum(counts)}")
    bounds.check(sum(counts[1::2]), bounds.INSIDE, "pixels inside", name)
    length = np.array(counts, dtype=np.int64)
    if 8 * int(length[1::2].sum()) > height * width:  # fewer bytes, and less time
        inside = np.repeat(np.arange(len(length)) % 2 == 1, length)
        return (height, width), np.flatnonzero(inside.reshape(width, height).T)
    end, length = np.cumsum(length)[1::2], length[1::2]
    column, row = np.divmod(np.arange(length.sum()) + np.repeat(end - np.cumsum(length), length), height)
    return (height, width), row * width + column


def declared_pixels(rle: Mapping[str, Any], name: str) -> int:
    """How many pixels inside run lengths declare, which may be wrong otherwise; errors as of :func:`rle_pixels`."""
    counts = rle.get("counts", ())
    if isinstance(counts, (str, bytes)):
        return int(_uncompressed(counts, f"{name}'s counts")[1::2].sum())
    return sum(counts[1::2]) if isinstance(counts, Sequence) and all(map(_is_integer, counts)) else 0


def _uncompressed(text: str | bytes, name: str) -> npt.NDArray[np.int64]:
    """The counts of a compressed string: 5 bits a character, lowest bits first.

    The sixth bit of a character means that the number continues in the next character. The fifth bit of the last
    character is the sign. From the fourth count on, the string has differences to the count two places before.
    """
    bounds.check(len(text), bounds.LINE, "characters", name)
    raw = np.frombuffer(text.encode() if isinstance(text, str) else text, np.uint8).astype(np.int64) - 48
    wrong = np.flatnonzero((raw < 0) | (raw >= 64))
    if len(wrong):
        raise ValueError(f"{name}: expected characters from '0' to 'o', got {chr(raw[wrong[0]] + 48)!r}")
    last = np.flatnonzero(raw < 32)  # the last character of each number
    if len(raw) and raw[-1] >= 32:
        raise ValueError(f"{name}: truncated, the last number is incomplete")
    length = np.diff(last, prepend=-1)
    bounds.check(int(length.max(initial=0)), _DIGITS, "characters of a number", name)
    shift = 5 * (np.arange(len(raw)) - np.repeat(last - length + 1, length))
    counts = np.add.reduceat((raw & 31) << shift, last - length + 1) if len(last) else last
    counts = counts - np.where(raw[last] & 16, np.int64(1) << (5 * length), 0)
    counts[1::2], counts[2::2] = np.cumsum(counts[1::2]), np.cumsum(counts[2::2])
    return counts


def _size(size: Any, name: str) -> tuple[int, int]:
    if not isinstance(size, Sequence) or len(size) != 2 or not all(_is_integer(s) and s > 0 for s in size):
        raise ValueError(f"{name}: expected two integers [H, W] of at least 1, got {size!r}")
    bounds.check_pixels(int(size[0]), int(size[1]), name)
    return int(size[0]), int(size[1])


def _is_integer(value: object) -> bool:
    return isinstance(value, (int, np.integer)) and not isinstance(value, bool)


def _described(value: object) -> str:
    return f"entries {', '.join(map(str, value))}" if isinstance(value, Mapping) else type(value).__name__


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
    strip, end = max(1, _STRIP // max(1, window.size[1])), window.row + window.size[0]
    rows = range(window.row, end, strip)
    pixels = [_strip_pixels(corners, window, row, min(strip, end - row)) + row * size[1] for row in rows]
    return np.concatenate([np.empty(0, np.int64), *pixels])


def work_of(corners: npt.NDArray[np.float64], size: tuple[int, int]) -> tuple[int, int]:
    """What :func:`polygon_pixels` takes: the pixels of the polygon's window, and the rows of its edges there."""
    window = Window(corners, size)
    return window.size[0] * window.size[1], int(_rows_of_edges(corners[:, 1] - window.row, window.size[0])[1].sum())


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
