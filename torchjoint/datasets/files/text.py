"""Reads text: files with one record per line, JSON of other programs, and the paths that both contain.

Errors name the file, and the line or the key.
"""

from __future__ import annotations

import math
import os
import sys
import warnings
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from io import TextIOWrapper
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchjoint.runtime import bounds
from torchjoint.runtime.foreign_files import damage_is, open_file, parse_json, read_json


def read_lines(path: Path, expected: str) -> Iterator[tuple[str, str]]:
    """Yields (name, line) for each line except comments (#); messages use `name`; `expected` describes the file."""
    is_damaged = damage_is(f"{path}: expected {expected} as text")
    with open_file(path, expected) as stream, is_damaged, TextIOWrapper(stream, "utf-8-sig") as text:
        for number, line in enumerate(iter(partial(text.readline, bounds.LINE), ""), 1):
            bounds.check(len(line), bounds.LINE - 1, f"characters in line {number}")
            if not line.startswith("#"):
                yield f"{path}: line {number}", line.strip()


def fields(lines: Iterator[tuple[str, str]], layout: str, least: int) -> Iterator[tuple[str, list[str]]]:
    """The first `least` words of each line that is not empty, the last one with the rest of the line; and its name."""
    for name, line in lines:
        words = line.split(maxsplit=least - 1)
        if words and len(words) < least:
            raise ValueError(f"{name}: expected {layout}, got {line[:100]!r}")
        if words:
            yield name, words


def parse_numbers(words: Sequence[str], name: str, *, finite: bool = True) -> list[float]:
    """Converts words to numbers, which must be finite unless `finite` is False; `1_0` is none, though Python's 10."""
    try:
        values = [float(word.replace("_", "?")) for word in words]
    except ValueError:
        values, finite = [math.nan], True
    if finite and not all(map(math.isfinite, values)):
        raise ValueError(f"{name}: expected finite numbers, got {' '.join(words)[:100]!r}")
    return values


def parse_integer(word: str, name: str) -> int:
    """Converts a word of a line to an integer of at most 18 digits."""
    if not (word.isascii() and word.removeprefix("-").isdigit() and len(word) < 19):
        raise ValueError(f"{name}: expected an integer, got {word[:100]!r}")
    return int(word)


def read_rows(path: Path, layout: str, columns: int) -> list[tuple[str, list[float]]]:
    """Reads lines of numbers, each with its name for messages; `layout` describes a line. Empty lines are skipped."""
    rows = []
    for name, line in read_lines(path, f"lines of {layout}"):
        numbers = parse_numbers(line.replace(",", " ").split(), name)
        if numbers and len(numbers) != columns:
            raise ValueError(f"{name}: expected {layout}, got {len(numbers)} numbers")
        if numbers:
            rows.append((name, numbers))
    return rows


def read_timed_rows(path: Path, layout: str, columns: int) -> npt.NDArray[np.float64]:
    """Reads lines of a time and other numbers, [N, columns], sorted by time; of equal times the first (told)."""
    table = np.array([numbers for _, numbers in read_rows(path, layout, columns)])
    if not len(table):
        raise ValueError(f"{path}: expected lines of {layout}, got none")
    kept = table[np.unique(table[:, 0], return_index=True)[1]]
    if others := len(np.unique(table, axis=0)) - len(kept):
        warnings.warn(f"{path}: lines of other numbers at the time of an earlier one, left out: {others}", stacklevel=5)
    return kept


class Record:
    """A JSON object. A missing value, or a value of the wrong type, raises ValueError with file and key.

    Args:
        values: the object.
        name: the file, and the place in it.
    """

    def __init__(self, values: Mapping[str, Any], name: str) -> None:
        self.values = values
        self.name = name

    def __contains__(self, key: str) -> bool:
        return self._value(key) is not None

    def number(self, key: str, default: float | None = None) -> float:
        """Returns a finite number; `default` if the key is missing."""
        return _number(self._get(key, default), f"{self.name}: {key}")

    def text(self, key: str, default: str | None = None) -> str:
        """Returns a string; `default` if the key is missing."""
        value = self._get(key, default)
        if not isinstance(value, str):
            raise ValueError(f"{self.name}: {key}: expected a string, got {_brief(value)}")
        return value

    def numbers(self, key: str, count: int) -> Tensor:
        """Returns a list of `count` numbers as [count] float64."""
        values = self._get(key)
        if not isinstance(values, list) or len(values) != count:
            raise ValueError(f"{self.name}: {key}: expected {count} numbers, got {_brief(values)}")
        return torch.tensor([_number(value, f"{self.name}: {key}") for value in values], dtype=torch.float64)

    def integers(self, key: str) -> npt.NDArray[np.int64]:
        """Returns a list of integers, of any length, as [length] int64."""
        values = self._value(key)
        if not isinstance(values, list) or not all(type(one) is int and -(1 << 63) <= one < 1 << 63 for one in values):
            raise ValueError(f"{self.name}: {key}: expected a list of integers of at most 64 bits")
        return np.array(values, dtype=np.int64)

    def matrix(self, key: str, columns: int) -> Tensor:
        """Returns rows of numbers as [rows, columns] float64."""
        rows = self._get(key)
        if not isinstance(rows, list) or not all(isinstance(row, list) and len(row) == columns for row in rows):
            raise ValueError(f"{self.name}: {key}: expected rows of {columns} numbers, got {_brief(rows)}")
        values = [[_number(value, f"{self.name}: {key}") for value in row] for row in rows]
        return torch.tensor(values, dtype=torch.float64).reshape(-1, columns)

    def record(self, key: str) -> Record:
        """Returns a nested object."""
        return _as_record(self._get(key), f"{self.name}: {key}")

    def records(self, key: str) -> list[Record]:
        """Returns a list of objects."""
        values = self._get(key)
        if not isinstance(values, list):
            raise ValueError(f"{self.name}: {key}: expected a list, got {_brief(values)}")
        return [_as_record(value, f"{self.name}: {key}[{index}]") for index, value in enumerate(values)]

    def _get(self, key: str, default: object = None) -> object:
        value = self._value(key)
        if value is None and default is None:
            raise ValueError(f"{self.name}: {key}: missing")
        return default if value is None else value

    def _value(self, key: str) -> object:
        value = self.values.get(key)
        if value is None:  # K1 for k1 would otherwise be a camera without distortion
            other = next((one for one in self.values if one != key and one.casefold() == key.casefold()), key)
            if self.values.get(other) is not None:
                raise ValueError(f"{self.name}: expected the key {key!r}, got {other!r}")
        return value


def numbers_of(records: Sequence[Record], key: str, count: int) -> Tensor:
    """Returns a list of `count` numbers of each of several objects as [objects, count] float64."""
    return torch.cat([torch.empty(0, count, dtype=torch.float64), *(one.numbers(key, count)[None] for one in records)])


def read_record(path: Path, expected: str) -> Record:
    """Reads a JSON file that holds an object; messages use `expected` to describe it."""
    return _as_record(read_json(path, expected), str(path))


def parse_record(data: bytes, name: str) -> Record:
    """Reads the bytes of a JSON file that holds an object."""
    return _as_record(parse_json(data, name), name)


def _as_record(values: object, name: str) -> Record:
    if not isinstance(values, dict):
        raise ValueError(f"{name}: expected an object, got {_brief(values)}")
    return Record(values, name)


def _number(value: object, name: str) -> float:
    # NaN is not below any number, and an integer may be larger than all floats.
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) <= sys.float_info.max:
        raise ValueError(f"{name}: expected a finite number, got {_brief(value)}")
    return float(value)


def _brief(value: object) -> str:
    # avoids repr of values that may take megabytes, or that are nested too deep for repr
    return type(value).__name__ if isinstance(value, (list, dict)) else repr(value)[:60]


def path_inside(folder: Path, name: str, source: str, *, or_inside: Sequence[Path] = ()) -> Path:
    """Resolves path `name` in file `source`, which is relative to `folder`; links within the folder are followed.

    A name with the backslashes of Windows is one with slashes, unless there is a file of that name.
    """
    if not _is_file_name(name):
        code = "" if name.isascii() else f" (LC_ALL: {sys.getfilesystemencoding()})"
        raise ValueError(f"{source}: expected a path of a file, got {name[:99]!r}{code}")
    if "\\" in name and not os.path.exists(os.path.join(folder, name)):
        name = name.replace("\\", "/")
    target = os.path.normpath(os.path.join(os.path.abspath(folder), name))
    for root in (folder, *or_inside):
        relative = os.path.relpath(target, os.path.abspath(root))
        if relative != os.curdir and relative.split(os.sep)[0] != os.pardir:
            return root / relative
    raise ValueError(f"{source}: expected a file inside {folder}, got {name!r}; give a relative path, without `..`")


def frame_names(files: Sequence[str]) -> list[str]:
    """Returns frame names that are valid file names: paths below the common folder, without suffix, `_` for `/`.

    Suffixes are kept if two names would otherwise be equal.

    Example:
        >>> frame_names(["./images/left/1.jpg", "images/right/1.jpg"])
        ['left_1', 'right_1']
    """
    paths = [os.path.normpath(file.replace("\\", "/")) for file in files]
    common = os.path.commonpath([os.path.dirname(path) for path in paths]) if paths else ""
    below = [os.path.relpath(path, common or ".").replace(os.sep, "_") for path in paths]
    stems = [os.path.splitext(name)[0] for name in below]
    return stems if len(set(stems)) == len(stems) else below


def _is_file_name(name: str) -> bool:
    try:
        raw = os.fsencode(name)
    except UnicodeEncodeError:
        return False
    # File systems allow 255 bytes per name and 4096 per path; a suffix and a folder may be added to this name.
    return bool(raw) and b"\0" not in raw and len(raw) < 2048 and max(map(len, raw.split(b"/"))) < 250
