"""Reads binary files with untrusted headers: checks that the data exist before it reads them."""

from __future__ import annotations

import mmap
import struct
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from torchjoint.runtime.foreign_files import damage_is, open_file, present


class BinaryFile:
    """Reads a little-endian file from front to back. A context manager."""

    def __init__(self, path: Path) -> None:
        present(path, "a binary file")
        self.path = path
        self.place = 0
        self.size = path.stat().st_size
        if self.size == 0:
            raise ValueError(f"{path}: is empty")
        with open_file(path) as stream:
            self._data = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)

    def __enter__(self) -> BinaryFile:
        return self

    def __exit__(self, *_: object) -> None:
        self._data.close()

    def read(self, layout: str) -> tuple[Any, ...]:
        """Reads values in a layout of :mod:`struct`; the layout has no byte-order character."""
        place = self.place
        self.skip(struct.calcsize("<" + layout))
        return struct.unpack_from("<" + layout, self._data, place)

    def array(self, dtype: npt.DTypeLike, count: int) -> npt.NDArray[Any]:
        """Reads an array of `count` numbers, or records, of a type."""
        place = self.place
        self.skip(np.dtype(dtype).itemsize * count)
        return np.frombuffer(self._data, dtype, count, place).copy()

    def count(self, smallest: int) -> int:
        """Reads an unsigned 64-bit count of the records that follow; each record has at least `smallest` bytes."""
        (count,) = self.read("Q")
        if count * smallest > self.size - self.place:
            raise ValueError(f"{self.path}: truncated: {count} records at byte {self.place} are more than it holds")
        return int(count)

    def text(self, longest: int = 4096) -> str:
        """Reads a string that ends with a zero byte; with this byte it has at most `longest` bytes."""
        end = self._data.find(b"\0", self.place, self.place + longest)
        if end < 0:
            raise ValueError(f"{self.path}: expected a string of at most {longest} bytes at byte {self.place}")
        raw, self.place = self._data[self.place : end], end + 1
        with damage_is(f"{self.path}: expected a string before byte {end}"):
            return raw.decode("utf-8")

    def skip(self, size: int) -> None:
        """Skips `size` bytes, which must exist."""
        if size > self.size - self.place:
            raise ValueError(f"{self.path}: truncated: expected {size} bytes at byte {self.place} of {self.size}")
        self.place += size

    def finish(self) -> None:
        """Checks that the file has no more bytes."""
        if self.place != self.size:
            rest = self.size - self.place
            raise ValueError(f"{self.path}: expected the end at byte {self.place}, got {rest} more bytes")
