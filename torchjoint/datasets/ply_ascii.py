"""The numbers of an ascii PLY file: each word of each line is accounted for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from torchjoint.datasets.ply_header import Element, PlyHeader, list_arrays
from torchjoint.ops import parse_numbers

Array = npt.NDArray[Any]
Bytes = npt.NDArray[np.uint8]

#: Characters of a line that are looked at to count its words.
_MAX_LINE = 1 << 16


def read_ascii(data: Bytes, header: PlyHeader) -> dict[str, Mapping[str, Array]]:
    """The columns of each element.

    Args:
        data: [B], of the whole file.
        header: of the file.

    Raises:
        ValueError: a line too few or too many, a word that is no number, or a number that does not fit its type.
    """
    body = data[header.size :]
    try:
        elements, place = _read_elements(body, header)
    except ValueError:
        _check_lines(body, header)  # says more than where the first number was missed
        raise
    if body[place:].tobytes().strip():
        _check_lines(body, header)
    if len(body) and body[-1] != ord("\n"):
        raise ValueError("truncated: expected a line break after the last number, which may be cut off")
    return elements


def _read_elements(body: Bytes, header: PlyHeader) -> tuple[dict[str, Mapping[str, Array]], int]:
    """The columns of each element, and the position behind them."""
    place = 0
    elements: dict[str, Mapping[str, Array]] = {}
    for element in header.elements:
        if not element.properties:
            continue
        text = body[place:]
        read = _equal_rows(text, element) if element.lists else _rows(text, element)
        elements[element.name], size = _rows_with_lists(text, element) if read is None else read
        place += size
    return elements, place


def _check_lines(body: Bytes, header: PlyHeader) -> None:
    text = body.tobytes().rstrip()
    lines = text.count(b"\n") + bool(text)
    expected = sum(element.rows for element in header.elements if element.properties)
    if lines != expected:
        counts = ", ".join(f"{element.rows} of {element.name}" for element in header.elements)
        raise ValueError(f"truncated, or too long: expected {expected} lines ({counts}), got {lines}")


def _table(text: Bytes, element: Element, columns: int) -> tuple[npt.NDArray[np.float64], int]:
    """The numbers of an element, [columns, rows], and the characters that were read."""
    try:
        values, end = parse_numbers(torch.from_numpy(text), element.rows, columns)
    except ValueError as error:
        raise ValueError(f"element {element.name}: {str(error).removeprefix('text: ')}") from error
    return values.numpy(), int(end)


def _rows(text: Bytes, element: Element) -> tuple[dict[str, Array], int]:
    values, size = _table(text, element, len(element.properties))
    return {one.name: _converted(values[i], one.kind, one.name) for i, one in enumerate(element.properties)}, size


def _equal_rows(text: Bytes, element: Element) -> tuple[dict[str, Array], int] | None:
    """The rows of an element whose lists have one length, such as triangles, as [rows, length]; None: it has others."""
    first = text[:_MAX_LINE].tobytes().partition(b"\n")[0].split()
    if not element.rows or not first:
        return None
    try:
        values, size = _table(text, element, len(first))
    except ValueError:
        return None
    columns, place = {}, 0
    for one in element.properties:
        length = 1
        if one.length is not None:
            lengths = _converted(values[place : place + 1], one.length, one.name)
            length, place = int(lengths[0, 0]) if lengths.size else -1, place + 1
            if (lengths != length).any():
                return None
        if not 0 <= length <= len(values) - place:
            return None
        read = _converted(values[place : place + length], one.kind, one.name)
        columns[one.name] = read[0] if one.length is None else read.T
        place += length
    return (columns, size) if place == len(values) else None


def _rows_with_lists(text: Bytes, element: Element) -> tuple[dict[str, Array], int]:
    lines = text.tobytes().split(b"\n", element.rows)
    rest = lines.pop() if len(lines) > element.rows else b""
    return _ascii_lists(lines, element), len(text) - len(rest)


def _ascii_lists(lines: list[bytes], element: Element) -> dict[str, Array]:
    columns: dict[str, list[Any]] = {name: [] for name in element.names}
    for line in lines:
        if b"_" in line:  # Python reads 1_0 as 10
            raise ValueError(f"element {element.name}: expected numbers, got {line[:80]!r}")
        words, place = [float(word) for word in line.split()], 0
        for one in element.properties:
            length = 1
            if one.length is not None:
                lengths = _converted(np.array(words[place : place + 1]), one.length, one.name)
                length, place = int(lengths[0]) if len(lengths) else 1, place + 1
            if not 0 <= length <= len(words) - place:
                raise ValueError(f"element {element.name}: expected {length} numbers of {one.name} in {line[:80]!r}")
            values = _converted(np.array(words[place : place + length]), one.kind, one.name)
            columns[one.name].append(values if one.length is not None else values[0])
            place += length
        if place != len(words):
            raise ValueError(f"element {element.name}: expected {place} numbers in {line[:80]!r}")
    return list_arrays(columns, element)


def _converted(values: npt.NDArray[np.float64], kind: str, name: str) -> Array:
    """Numbers from text in the type of their property; integers must fit into it."""
    dtype = np.dtype(kind)
    with np.errstate(over="ignore", invalid="ignore"):
        converted = values.astype(dtype, copy=False)
    if dtype.kind != "f" and (converted != values).any():  # also of NaN
        raise ValueError(f"property {name}: expected integers of {dtype.itemsize * 8} bits")
    return converted
