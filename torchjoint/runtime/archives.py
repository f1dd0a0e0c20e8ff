"""Reads NumPy's .npz archives from untrusted sources: checks sizes against the file before it allocates memory."""

from __future__ import annotations

import math
import os
import zipfile
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from torchjoint.runtime.foreign_files import damage_is, present

#: Limit of an unpacked archive, bytes: RATIO x its file + FREE. Labels compress well, decompression bombs even better.
RATIO, FREE = 100, 1 << 30


def read_archive(path: Path, names: Collection[str] | None = None) -> dict[str, npt.NDArray[Any]]:
    """Reads the arrays of an archive by name.

    Args:
        path: of the archive.
        names: of the arrays to read; names that the archive lacks are ignored; None: all arrays.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the archive is damaged, holds an array of objects, or declares more data than the file can hold; the
            message names the file.
    """
    present(path, "arrays, .npz")
    with damage_is(f"{path}: not a whole archive of arrays", OSError), zipfile.ZipFile(path) as archive:
        entries = archive.infolist()
        _check_number(archive, len(entries))
        size, most = sum(entry.file_size for entry in entries), RATIO * path.stat().st_size + FREE
        if size > most:
            raise ValueError(f"expected at most {most / 1e9:.3g} GB in so small a file, got {size / 1e9:.3g} GB")
        named = {entry.filename.removesuffix(".npy"): entry for entry in entries}
        return {name: _read_array(archive, named[name]) for name in named if names is None or name in names}


def _check_number(archive: zipfile.ZipFile, got: int) -> None:
    """Raise unless the archive declares `got` arrays: damaged lengths in its directory would hide arrays."""
    assert archive.fp is not None
    archive.fp.seek(-(22 + len(archive.comment)), os.SEEK_END)  # the end record: 22 bytes and a comment
    number = int.from_bytes(archive.fp.read(12)[-2:], "little")
    if number not in (got, 0xFFFF):  # 0xFFFF: a larger number is stored elsewhere
        raise ValueError(f"expected the {number} arrays that it declares, got {got}")


def _read_array(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> npt.NDArray[Any]:
    with archive.open(entry) as stream:
        version = np.lib.format.read_magic(stream)
        read_header = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
        if version not in read_header:
            raise ValueError(f"array {entry.filename}: expected version (1, 0) or (2, 0), got {version}")
        shape, _, dtype = read_header[version](stream)
        if math.prod(shape) * dtype.itemsize > entry.file_size:
            raise ValueError(f"array {entry.filename}: expected a shape that fits the archive, got {list(shape)}")
    with archive.open(entry) as stream:
        array: npt.NDArray[Any] = np.lib.format.read_array(stream, allow_pickle=False)
        return array
