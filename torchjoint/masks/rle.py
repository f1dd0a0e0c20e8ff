"""Run lengths of COCO's format: numbers of pixels, column by column, outside the mask, inside, outside, and so on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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
        raise ValueError(
            f"{name}'s counts: expected a sum of {height} x {width} = {height * width} pixels, got {sum(counts)}"
        )
    bounds.check(sum(counts[1::2]), bounds.INSIDE, "pixels inside", name)
    length = np.array(counts, dtype=np.int64)
    if 8 * int(length[1::2].sum()) > height * width:  # fewer bytes, and less time
        inside = np.repeat(np.arange(len(length)) % 2 == 1, length)
        return (height, width), np.flatnonzero(inside.reshape(width, height).T)
    end, length = np.cumsum(length)[1::2], length[1::2]
    place = np.arange(length.sum()) + np.repeat(end - np.cumsum(length), length)
    column, row = np.divmod(place, height)
    return (height, width), row * width + column


def declared_pixels(rle: Mapping[str, Any], name: str) -> int:
    """How many pixels inside run lengths declare, which may be wrong otherwise; errors as of :func:`rle_pixels`."""
    counts = rle.get("counts", ())
    if isinstance(counts, (str, bytes)):
        return int(_uncompressed(counts, f"{name}'s counts")[1::2].sum())
    is_list = isinstance(counts, Sequence) and all(map(_is_integer, counts))
    return sum(counts[1::2]) if is_list else 0


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
