"""The numbers of an ascii PLY file: each word of each line is accounted for."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from torchjoint.datasets.ply_header import Element, PlyHeader, list_arrays

Array = npt.NDArray[Any]


def read_ascii(data: bytes, header: PlyHeader) -> dict[str, Mapping[str, Array]]:
    """The columns of each element.

    Args:
        data: of the whole file.
        header: of the file.

    Raises:
        ValueError: a line too few or too many, a word that is no number, or a number that does not fit its type.
    """
    body = data[header.size :]
    text = body.rstrip() + b"\n"
    ends, words = _lines(text) if body.strip() else (np.empty(0, np.int64), np.empty(0, np.int64))
    expected = sum(element.rows for element in header.elements if element.properties)
    if len(ends) != expected:
        counts = ", ".join(f"{element.rows} of {element.name}" for element in header.elements)
        raise ValueError(f"truncated, or too long: expected {expected} lines ({counts}), got {len(ends)}")
    if body and not body.endswith(b"\n"):
        raise ValueError("truncated: expected a line break after the last number, which may be cut off")
    place, start = 0, 0
    elements: dict[str, Mapping[str, Array]] = {}
    for element in header.elements:
        if not element.properties:
            continue
        rows = slice(place, place + element.rows)
        end = int(ends[rows.stop - 1]) if element.rows else start
        if element.lists:
            elements[element.name] = _ascii_lists(text[start:end].splitlines(), element)
        else:
            elements[element.name] = _ascii_rows(text[start:end], words[rows], element)
        place, start = rows.stop, end
    return elements


def _lines(text: bytes) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """The end of each line, behind its line break, and the number of words in it."""
    characters = np.frombuffer(text, np.uint8)
    is_space = (characters == 32) | ((characters >= 9) & (characters <= 13))
    begins = ~is_space & np.concatenate([[True], is_space[:-1]])
    ends = np.flatnonzero(characters == 10) + 1
    counted = np.searchsorted(np.flatnonzero(begins), ends)
    return ends, np.diff(counted, prepend=0)


def _ascii_rows(text: bytes, words: npt.NDArray[np.int64], element: Element) -> dict[str, Array]:
    columns = len(element.properties)
    wrong = np.flatnonzero(words != columns)
    if len(wrong):
        raise ValueError(
            f"element {element.name}: expected {columns} numbers in row {wrong[0]}, got {words[wrong[0]]} words"
        )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # about what is no number, with an older NumPy
            values = np.fromstring(text.decode("ascii", errors="replace"), np.float64, sep=" ")
    except (ValueError, DeprecationWarning) as error:
        raise ValueError(f"element {element.name}: a word is no number: {error}") from error
    if len(values) != element.rows * columns:
        raise ValueError(f"element {element.name}: {len(values)} numbers in {element.rows * columns} words")
    table = values.reshape(-1, columns)
    return {one.name: _converted(table[:, place], one.kind, one.name) for place, one in enumerate(element.properties)}


def _ascii_lists(lines: list[bytes], element: Element) -> dict[str, Array]:
    columns: dict[str, list[Any]] = {name: [] for name in element.names}
    for line in lines:
        if b"_" in line:  # Python reads 1_0 as 10
            raise ValueError(f"element {element.name}: expected numbers, got {line[:80]!r}")
        words, place = [float(word) for word in line.split()], 0
        for one in element.properties:
            length = 1
            if one.length is not None:
                length = int(_converted(np.array(words[place : place + 1]), one.length, one.name)[0])
                place += 1
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
    if dtype.kind == "f":
        with np.errstate(over="ignore"):
            return values.astype(dtype)
    limits = np.iinfo(dtype)
    if not len(values) or ((values >= limits.min) & (values <= limits.max) & (values == np.floor(values))).all():
        return values.astype(dtype)
    raise ValueError(f"property {name}: expected integers of {dtype.itemsize * 8} bits")
