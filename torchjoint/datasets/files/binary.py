"""Reads binary files with untrusted headers, and members of archives: checks that data exist before it reads them."""

from __future__ import annotations

import mmap
import struct
import zlib
from pathlib import Path
from typing import Any
from zipfile import ZIP_DEFLATED, ZIP_STORED, ZipFile

import numpy as np
import numpy.typing as npt

from torchjoint.runtime import bounds
from torchjoint.runtime.foreign_files import damage_is, dict_of, has_file, has_folder, open_file, present, read_file


class BinaryFile:
    """Reads a little-endian file from front to back. A context manager.

    Args:
        path: of the file.
        name: begins the messages; None: the path.
    """

    def __init__(self, path: Path, name: str | None = None) -> None:
        self.name = str(path) if name is None else name
        self.place = 0
        self.size = present(path, "a binary file").stat().st_size
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
            raise ValueError(f"{self.name}: truncated: {count} records at byte {self.place} are more than it holds")
        return int(count)

    def text(self, longest: int = 4096) -> str:
        """Reads a string that ends with a zero byte; with this byte it has at most `longest` bytes."""
        end = self._data.find(b"\0", self.place, self.place + longest)
        if end < 0:
            raise ValueError(f"{self.name}: expected a string of at most {longest} bytes at byte {self.place}")
        raw, self.place = self._data[self.place : end], end + 1
        with damage_is(f"{self.name}: expected a string before byte {end}"):
            return raw.decode("utf-8")

    def skip(self, size: int) -> None:
        """Skips `size` bytes, which must exist."""
        if size > self.size - self.place:
            raise ValueError(f"{self.name}: truncated: expected {size} bytes at byte {self.place} of {self.size}")
        self.place += size

    def finish(self) -> None:
        """Checks that the file has no more bytes."""
        if self.place != self.size:
            rest = self.size - self.place
            raise ValueError(f"{self.name}: expected the end at byte {self.place}, got {rest} more bytes")


class Members:
    """The files of a zip archive, or of a folder and the folders in it.

    Args:
        path: of the archive or folder. The directory of an archive is read once: it may have 10,000 entries.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        if has_folder(path):
            files = (file for pattern in ("*", "*/*") for file in path.glob(pattern))
            self.names = {file.relative_to(path).as_posix() for file in files if has_file(file)}
            return
        with damage_is(f"{path}: not a whole archive", OSError), ZipFile(path) as archive:
            self._entries = dict_of([(entry.filename, entry) for entry in archive.infolist()], "file")
        self.names = set(self._entries)

    def read(self, name: str, most: int) -> bytes:
        """Reads a file of at most `most` bytes."""
        if name not in self.names:
            raise ValueError(f"{self.path}: {name} is missing")
        if has_folder(self.path):
            return read_file(self.path / name, "a part of a recording", most)
        bounds.check(self._entries[name].file_size, most, "bytes", f"{self.path}: {name}")
        return self._unpack(name)

    def _unpack(self, name: str) -> bytes:
        entry = self._entries[name]
        with damage_is(f"{self.path}: {name} in it is damaged", OSError):
            with open_file(self.path) as stream:
                stream.seek(entry.header_offset)
                header = stream.read(30)  # its last two numbers are the lengths of a name and of an extra field
                stream.seek(sum(int.from_bytes(header[at : at + 2], "little") for at in (26, 28)), 1)
                data = stream.read(min(entry.compress_size, self.path.stat().st_size))
            if entry.compress_type == ZIP_DEFLATED:
                data = zlib.decompressobj(-zlib.MAX_WBITS).decompress(data, entry.file_size + 1)
            elif entry.compress_type != ZIP_STORED:
                raise ValueError(f"compression {entry.compress_type} is not known")
            if len(data) != entry.file_size or zlib.crc32(data) != entry.CRC:
                raise ValueError("its size or checksum is another one")
        return data
