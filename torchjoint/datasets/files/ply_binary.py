"""Reads the numbers of a binary PLY file of either byte order; every byte is checked, and few are copied."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from torchjoint.datasets.files.ply_columns import Block, Columns, Lists
from torchjoint.datasets.files.ply_header import Element, PlyHeader
from torchjoint.runtime import bounds
from torchjoint.runtime.foreign_files import open_file

Array = npt.NDArray[Any]

#: The characters of module struct for the types of a list's length.
_COUNTS = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I"}
#: Rows that are read at a time.
_BLOCK = 1 << 15


def read_binary(path: Path, header: PlyHeader) -> dict[str, Columns]:
    """Reads the columns of each element; those of an element without lists stay in the file until they are used.

    Raises:
        ValueError: the file has too few or too many bytes, or a list has a negative length.
    """
    size, place = path.stat().st_size, header.size
    has_lists = any(element.lists for element in header.elements)
    data = np.fromfile(path, np.uint8) if has_lists else np.empty(0, np.uint8)
    elements: dict[str, Columns] = {}
    for element in header.elements:
        if not element.properties:
            continue
        if element.lists:
            columns, place = _rows_with_lists(data, place, element, header)
            elements[element.name] = Columns.of(columns, element.rows)
            continue
        dtype = element.dtype(header.byte_order)
        _check_rest(size, place, dtype.itemsize * element.rows, element)
        elements[element.name] = _rows(path, place, element, dtype)
        place += dtype.itemsize * element.rows
    with open_file(path) as stream:
        stream.seek(place)
        while rest := stream.read(1 << 20):
            if rest.strip():
                raise ValueError(f"expected the end at byte {place}, got {size - place} more bytes")
    return elements


def _rows(path: Path, place: int, element: Element, dtype: np.dtype[Any]) -> Columns:
    def blocks() -> Iterator[Block]:
        block = np.empty(min(_BLOCK, element.rows), dtype)
        with path.open("rb", buffering=0) as stream:
            stream.seek(place)
            for start in range(0, element.rows, _BLOCK):
                some = block[: element.rows - start]
                if stream.readinto(some.view(np.uint8).data) != some.nbytes:
                    raise ValueError(f"truncated while it is read: element {element.name}, row {start}")
                yield slice(start, start + len(some)), some

    return Columns(element.rows, {name: dtype[name] for name in element.names}, blocks)


def _rows_with_lists(
    data: Array, place: int, element: Element, header: PlyHeader
) -> tuple[dict[str, Array | Lists], int]:
    """The rows of an element with lists."""
    smallest = sum(np.dtype(p.length or p.kind).itemsize for p in element.properties)
    _check_rest(len(data), place, smallest * element.rows, element)
    if element.rows == 0:
        return {}, place
    lengths = _lengths(data, place, element, header)
    dtype = element.dtype(header.byte_order, lengths)
    if dtype.itemsize * element.rows <= len(data) - place:
        rows = np.frombuffer(data, dtype, element.rows, place)
        if all((rows[f"#{name}"] == length).all() for name, length in lengths.items()):
            return {name: rows[name] for name in element.names}, place + rows.nbytes
    return _rows_of_several_lengths(memoryview(data.data), place, element, header)


def _rows_of_several_lengths(
    data: memoryview, place: int, element: Element, header: PlyHeader
) -> tuple[dict[str, Array | Lists], int]:
    """The rows one by one: where a list begins depends on all lists before it. Numbers stay bytes until the end."""
    bounds.check(element.rows, bounds.LIST_ROWS, f"rows of lists of several lengths in element {element.name}")
    found = [bytearray() for _ in element.properties]
    lengths = [np.ones(element.rows if one.length else 0, np.int64) for one in element.properties]
    steps = [
        (np.dtype(one.kind).itemsize, struct.Struct(header.byte_order + _COUNTS[one.length]) if one.length else None)
        for one in element.properties
    ]
    for row in range(element.rows):
        for column, (size, count) in enumerate(steps):
            length = 1
            if count is not None:
                _check_rest(len(data), place, count.size, element)
                length = count.unpack_from(data, place)[0]
                if length < 0:
                    raise ValueError(f"element {element.name}: a list of {length} numbers")
                lengths[column][row] = length
                place += count.size
            end = place + length * size
            if end > len(data):
                _check_rest(len(data), place, length * size, element)
            found[column] += data[place:end]
            place = end
    columns: dict[str, Array | Lists] = {}
    for one, raw, of_rows in zip(element.properties, found, lengths, strict=True):
        values = np.frombuffer(raw, header.byte_order + one.kind)
        columns[one.name] = Lists.of(values, of_rows) if one.length else values
    return columns, place


def _lengths(data: Array, place: int, element: Element, header: PlyHeader) -> dict[str, int]:
    """The lengths of the lists in the row at `place`."""
    lengths = {}
    for one in element.properties:
        if one.length is not None:
            _check_rest(len(data), place, np.dtype(one.length).itemsize, element)
            length = int(np.frombuffer(data, np.dtype(header.byte_order + one.length), 1, place)[0])
            if length < 0:
                raise ValueError(f"element {element.name}: a list of {length} numbers")
            lengths[one.name] = length
            place += np.dtype(one.length).itemsize + length * np.dtype(one.kind).itemsize
        else:
            place += np.dtype(one.kind).itemsize
        _check_rest(len(data), place, 0, element)
    return lengths


def _check_rest(available: int, place: int, size: int, element: Element) -> None:
    if size > available - place:
        raise ValueError(
            f"truncated: {element.rows} of element {element.name} need {size} bytes at byte {place}, "
            f"got {max(0, available - place)}"
        )
