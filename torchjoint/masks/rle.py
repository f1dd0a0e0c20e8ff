"""Run lengths of COCO's format: numbers of pixels, column by column, outside the mask, inside, outside, and so on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchjoint.datasets.files.readers import MAX_PIXELS


def decode_rle(rle: Mapping[str, Any], name: str = "segmentation") -> Tensor:
    """The mask [H, W] bool of run lengths.

    Args:
        rle: ``size`` [H, W], and ``counts``: a list of numbers, or COCO's compressed string.
        name: name of the mask in messages.

    Raises:
        ValueError, TypeError: naming the entry; also if the sum of the counts is not H x W.

    >>> decode_rle({"size": [2, 3], "counts": [1, 2, 3]}).int()
    tensor([[0, 1, 0],
            [1, 0, 0]], dtype=torch.int32)
    """
    if not isinstance(rle, Mapping) or not {"size", "counts"} <= set(rle):
        raise ValueError(f"{name}: expected run lengths with size and counts, got {_described(rle)}")
    height, width = _size(rle["size"], f"{name}'s size")
    counts = rle["counts"]
    if isinstance(counts, (str, bytes)):
        counts = _uncompressed(counts, f"{name}'s counts")
    elif not isinstance(counts, Sequence) or not all(_is_integer(count) for count in counts):
        raise TypeError(f"{name}'s counts: expected a string or a list of integers, got {_described(counts)}")
    if any(count < 0 for count in counts):
        raise ValueError(f"{name}'s counts: expected numbers >= 0, got {min(counts)}")
    if sum(counts) != height * width:
        raise ValueError(
            f"{name}'s counts: expected a sum of {height} x {width} = {height * width} pixels, got {sum(counts)}"
        )
    inside = np.arange(len(counts)) % 2 == 1
    columns = np.repeat(inside, np.array(counts, dtype=np.int64)).reshape(width, height)
    return torch.from_numpy(columns.T.copy())


def _uncompressed(text: str | bytes, name: str) -> list[int]:
    """The counts of a compressed string: 5 bits a character, lowest bits first.

    The sixth bit of a character means that the number continues in the next character. The fifth bit of the last
    character is the sign. From the fourth count on, the string has differences to the count two places before.
    """
    counts: list[int] = []
    number, shift = 0, 0
    for character in text.encode() if isinstance(text, str) else text:
        bits = character - 48
        if not 0 <= bits < 64:
            raise ValueError(f"{name}: expected characters from '0' to 'o', got {chr(character)!r}")
        number |= (bits & 31) << shift
        shift += 5
        if bits & 32:
            continue
        if bits & 16:
            number -= 1 << shift
        counts.append(number + (counts[-2] if len(counts) > 2 else 0))
        number, shift = 0, 0
    if shift:
        raise ValueError(f"{name}: truncated, the last number is incomplete")
    return counts


def _size(size: Any, name: str) -> tuple[int, int]:
    if not isinstance(size, Sequence) or len(size) != 2 or not all(_is_integer(s) and s > 0 for s in size):
        raise ValueError(f"{name}: expected two integers [H, W] of at least 1, got {size!r}")
    if int(size[0]) * int(size[1]) > MAX_PIXELS:
        raise ValueError(f"{name}: {size[0]} x {size[1]} pixels are too many (at most {MAX_PIXELS})")
    return int(size[0]), int(size[1])


def _is_integer(value: object) -> bool:
    return isinstance(value, (int, np.integer)) and not isinstance(value, bool)


def _described(value: object) -> str:
    return f"entries {', '.join(map(str, value))}" if isinstance(value, Mapping) else type(value).__name__
