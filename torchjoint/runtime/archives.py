"""Reads NumPy's .npz archives from untrusted sources: checks sizes against the file before it allocates memory."""

import math
import os
import zipfile
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from torchjoint.runtime import bounds
from torchjoint.runtime.files import atomic_write
from torchjoint.runtime.foreign_files import damage_is, no_twice, open_file, present


def read_archive(
    path: Path, names: Collection[str] | None = None, most: int | None = None
) -> dict[str, npt.NDArray[Any]]:
    """Reads the arrays of an archive by name.

    Args:
        path: of the archive.
        names: of the arrays to read; names that the archive lacks are ignored; None: all arrays.
        most: bytes of all arrays; None: only what the size of the file allows.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the archive is damaged, holds an array of objects, or declares more data than the file can hold; the
            message names the file.
    """
    present(path, "arrays, .npz")
    with damage_is(f"{path}: not a whole archive of arrays", OSError), zipfile.ZipFile(path) as archive:
        entries = archive.infolist()
        _check_number(archive, len(entries))
        size = sum(entry.file_size for entry in entries)
        bounds.check_unpacked(size, path.stat().st_size)
        bounds.check(size, size if most is None else most, "bytes of arrays")
        no_twice((entry.filename.removesuffix(".npy") for entry in entries), "array")
        named = {entry.filename.removesuffix(".npy"): entry for entry in entries}
        return {name: _read_array(archive, named[name]) for name in named if names is None or name in names}


def write_archive(path: Path, arrays: Mapping[str, npt.NDArray[Any]]) -> None:
    """Writes an archive, compressed and atomically."""
    with atomic_write(path) as partial, partial.open("wb") as stream:  # NumPy would add .npz to a path
        np.savez_compressed(stream, **arrays)  # type: ignore[arg-type]


def _check_number(archive: zipfile.ZipFile, got: int) -> None:
    """Raise unless the archive declares `got` arrays: damaged lengths in its directory would hide arrays."""
    assert archive.fp is not None
    archive.fp.seek(-(22 + len(archive.comment)), os.SEEK_END)  # the end record: 22 bytes and a comment
    number = int.from_bytes(archive.fp.read(12)[-2:], "little")
    if number not in (got, 0xFFFF):  # 0xFFFF: a larger number is stored elsewhere
        raise ValueError(f"expected the {number} arrays that it declares, got {got}")


def _read_array(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> npt.NDArray[Any]:
    with archive.open(entry) as stream:
        check_header(stream, entry.file_size, f"array {entry.filename}")
    with archive.open(entry) as stream, damage_is(f"array {entry.filename}"):
        return np.lib.format.read_array(stream, allow_pickle=False)


def read_npy(path: Path) -> npt.NDArray[Any]:
    """Reads an array, .npy."""
    with (
        open_file(path, "an array of numbers, .npy") as stream,
        damage_is(f"{path}: not a whole .npy array of numbers"),
    ):
        check_header(stream, os.fstat(stream.fileno()).st_size, "array")
        stream.seek(0)
        array: npt.NDArray[Any] = np.lib.format.read_array(stream, allow_pickle=False)
        if stream.read(1):
            raise ValueError(f"expected one array, got more behind the first, of shape {list(array.shape)}")
        return array


def check_header(stream: IO[bytes], size: int, name: str) -> None:
    """Reads the header of an array of NumPy in `size` bytes, and checks that its numbers or texts lie in them."""
    version = np.lib.format.read_magic(stream)
    read_header = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    if version not in read_header:
        raise ValueError(f"{name}: expected version (1, 0) or (2, 0), got {version}")
    shape, _, dtype = read_header[version](stream)
    if dtype.kind not in "biufUS" or dtype.itemsize == 0:
        raise ValueError(f"{name}: expected numbers, or texts of at least one character, got dtype {dtype}")
    if min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize > size:
        raise ValueError(f"{name}: expected a shape that fits the file, got {list(shape)}")


def as_int64(values: npt.NDArray[Any], name: str) -> npt.NDArray[Any]:
    """Integers as int64, which torch knows, unless they are; other arrays stay."""
    if values.dtype.kind != "u" or values.dtype.itemsize == 1:
        return values
    if values.dtype.itemsize == 8 and int(values.max(initial=0)) >= 1 << 63:
        raise ValueError(f"{name}: expected integers below 2^63, got {int(values.max())}")
    return values.astype(np.int64)
