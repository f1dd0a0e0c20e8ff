"""Reads the numbers of an ascii PLY file; every word of every line is checked."""

from __future__ import annotations

from array import array
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from torchjoint.datasets.files.ply_columns import Columns, Lists
from torchjoint.datasets.files.ply_header import Element, PlyHeader
from torchjoint.ops.internal import parse_numbers
from torchjoint.runtime import bounds

Array = npt.NDArray[Any]
Bytes = npt.NDArray[np.uint8]

#: Characters that are read of an element's first line, to count its words.
_MAX_LINE = 1 << 16
#: Rows that are read at a time: their float64 numbers stay in the cache.
_BLOCK = 1 << 14


def read_ascii(path: Path, header: PlyHeader) -> dict[str, Columns]:
    """Reads the columns of each element.

    Raises:
        ValueError: too few or too many lines, a word that is no number, or a number that does not fit its type.
    """
    body = np.fromfile(path, np.uint8, offset=header.size)
    try:
        elements, place = _read_elements(body, header)
    except ValueError:
        _check_lines(body, header)  # a wrong number of lines explains more than the first missing number
        raise
    if body[place:].tobytes().strip():
        _check_lines(body, header)
    if len(body) and body[-1] != ord("\n"):
        raise ValueError("truncated: expected a line break after the last number, which may be cut off")
    return elements


def _read_elements(body: Bytes, header: PlyHeader) -> tuple[dict[str, Columns], int]:
    """The columns of each element, and the position after them."""
    place = 0
    elements: dict[str, Columns] = {}
    for element in header.elements:
        if not element.properties:
            continue
        text = body[place:]
        read = _equal_rows(text, element) if element.lists else _rows(text, element)
        columns: Mapping[str, Array | Lists]
        columns, size = _rows_with_lists(text, element) if read is None else read
        elements[element.name] = Columns.of(columns, element.rows)
        place += size
    return elements, place


def _check_lines(body: Bytes, header: PlyHeader) -> None:
    text = body.tobytes().rstrip()
    lines = text.count(b"\n") + bool(text)
    expected = sum(element.rows for element in header.elements if element.properties)
    if lines != expected:
        counts = ", ".join(f"{element.rows} of {element.name}" for element in header.elements)
        raise ValueError(f"truncated, or too long: expected {expected} lines ({counts}), got {lines}")


def _rows(text: Bytes, element: Element) -> tuple[dict[str, Array], int]:
    """The rows of an element without lists, and the characters that were read."""
    columns, size = _columns(text, element, [(one.kind, one.name) for one in element.properties])
    return dict(zip(element.names, columns, strict=True)), size


def _equal_rows(text: Bytes, element: Element) -> tuple[dict[str, Array], int] | None:
    """The rows of an element if all its lists have one length, as triangles have, as [rows, length]; else None."""
    words = text[:_MAX_LINE].tobytes().partition(b"\n")[0].split()
    kinds: list[tuple[str, str]] = []
    lengths: dict[str, int] = {}
    for one in element.properties:
        if one.length is not None:
            word = words[len(kinds)] if len(kinds) < len(words) else b""
            lengths[one.name] = int(word) if word.isdigit() and len(word) < 6 else len(words)
            kinds.append((one.length, one.name))
        kinds += [(one.kind, one.name)] * lengths.get(one.name, 1)
        if len(kinds) > len(words):
            return None
    try:
        columns, size = _columns(text, element, kinds)
    except ValueError:
        return None
    read: dict[str, Array] = {}
    for one in element.properties:
        if one.length is None:
            read[one.name] = columns.pop(0)
            continue
        if (columns.pop(0) != lengths[one.name]).any():
            return None
        own, columns = columns[: lengths[one.name]], columns[lengths[one.name] :]
        read[one.name] = np.stack(own, axis=1) if own else np.empty((element.rows, 0), one.kind)
    return read, size


def _columns(text: Bytes, element: Element, kinds: list[tuple[str, str]]) -> tuple[list[Array], int]:
    """The columns of rows of equal length, each in its type, and how many characters were read; `kinds`: type, name."""
    numbers, place = torch.from_numpy(text), 0
    try:
        if element.rows * len(kinds) > len(text):  # before memory is allocated
            parse_numbers(numbers, element.rows, len(kinds))
        columns = [np.empty(element.rows, kind) for kind, _ in kinds]
        for start in range(0, element.rows, _BLOCK):
            rows = slice(start, min(start + _BLOCK, element.rows))
            values, end = parse_numbers(numbers[place:], rows.stop - rows.start, len(kinds))
            place += int(end)
            for column, read, (kind, name) in zip(columns, values.numpy(), kinds, strict=True):
                column[rows] = _converted(read, kind, name)
    except ValueError as error:
        if str(error).startswith("text: "):
            raise ValueError(f"element {element.name}: {_message(numbers, element.rows, len(kinds))}") from error
        raise
    return columns, place


def _message(text: torch.Tensor, num_rows: int, num_columns: int) -> str:
    """What is wrong with rows, numbered from the element's first one."""
    try:
        parse_numbers(text, num_rows, num_columns)
    except ValueError as error:
        return str(error).removeprefix("text: ")
    raise AssertionError("rows that are wrong in a block are wrong in the whole")


def _rows_with_lists(text: Bytes, element: Element) -> tuple[dict[str, Array | Lists], int]:
    bounds.check(element.rows, bounds.LIST_ROWS, f"rows of lists of several lengths in element {element.name}")
    lines = text.tobytes().split(b"\n", element.rows)
    rest = lines.pop() if len(lines) > element.rows else b""
    return _ascii_lists(lines, element), len(text) - len(rest)


def _ascii_lists(lines: list[bytes], element: Element) -> dict[str, Array | Lists]:
    found = {name: array("d") for name in element.names}
    lengths = {one.name: array("d") for one in element.properties if one.length is not None}
    for line in lines:
        if b"_" in line:  # Python reads 1_0 as 10
            raise ValueError(f"element {element.name}: expected numbers, got {line[:80]!r}")
        words, place = [float(word) for word in line.split()], 0
        for one in element.properties:
            length = 1
            if one.length is not None:
                read = _converted(np.array(words[place : place + 1]), one.length, one.name)
                length, place = int(read[0]) if len(read) else 1, place + 1
                lengths[one.name].append(length)
            if not 0 <= length <= len(words) - place:
                raise ValueError(f"element {element.name}: expected {length} numbers of {one.name} in {line[:80]!r}")
            found[one.name].extend(words[place : place + length])
            place += length
        if place != len(words):
            raise ValueError(f"element {element.name}: expected {place} numbers in {line[:80]!r}")
    columns: dict[str, Array | Lists] = {}
    for one in element.properties:
        values = _converted(np.array(found[one.name]), one.kind, one.name)
        of_rows = np.array(lengths.get(one.name, ())).astype(np.int64)
        columns[one.name] = values if one.length is None else Lists.of(values, of_rows)
    return columns


def _converted(values: npt.NDArray[np.float64], kind: str, name: str) -> Array:
    """Numbers from text in the type of their property; integers must fit into it."""
    dtype = np.dtype(kind)
    with np.errstate(over="ignore", invalid="ignore"):
        converted = values.astype(dtype, copy=False)
    if dtype.kind != "f" and (converted != values).any():  # also of NaN
        raise ValueError(f"property {name}: expected integers of {dtype.itemsize * 8} bits")
    return converted
