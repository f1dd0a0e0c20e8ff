"""Reads JSON files from other programs: objects whose values are requested by type."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchjoint.runtime.foreign_files import parse_json, read_json


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
        return self.values.get(key) is not None

    def number(self, key: str, default: float | None = None) -> float:
        """Returns a finite number; `default` if the key is missing."""
        value = self._get(key, default)
        return _number(value, f"{self.name}: {key}")

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
        values = self.values.get(key)
        try:
            if isinstance(values, list) and all(type(value) is int for value in values):
                return np.array(values, dtype=np.int64)
        except OverflowError:
            pass
        raise ValueError(f"{self.name}: {key}: expected a list of integers of at most 64 bits")

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
        value = self.values.get(key)
        if value is None and default is None:
            raise ValueError(f"{self.name}: {key}: missing")
        return default if value is None else value


def read_record(path: Path, expected: str) -> Record:
    """Reads a JSON file that holds an object; messages use `expected` to describe it.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is too large, is not JSON, or holds no object.
    """
    return _as_record(read_json(path, expected), str(path))


def parse_record(data: bytes, name: str) -> Record:
    """Reads the bytes of a JSON file that holds an object.

    Raises:
        ValueError: the bytes are not JSON, or hold no object.
    """
    return _as_record(parse_json(data, name), name)


def _as_record(values: object, name: str) -> Record:
    if not isinstance(values, dict):
        raise ValueError(f"{name}: expected an object, got {_brief(values)}")
    return Record(values, name)


def _number(value: object, name: str) -> float:
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if math.isfinite(number):
            return number
    raise ValueError(f"{name}: expected a finite number, got {_brief(value)}")


def _brief(value: object) -> str:
    # avoids repr of values that may take megabytes, or that are nested too deep for repr
    return type(value).__name__ if isinstance(value, (list, dict)) else repr(value)[:60]
