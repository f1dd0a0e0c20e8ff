"""Reads NumPy's .npz archives from untrusted sources: sizes are compared with the file before memory is allocated."""

from __future__ import annotations

import math
import os
import tokenize
import zipfile
import zlib
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

#: An archive may be this many times as large as its file, and FREE bytes more. Labels compress well, bombs better.
RATIO, FREE = 100, 1 << 30


def read_archive(path: Path, names: Collection[str] | None = None) -> dict[str, npt.NDArray[Any]]:
    """The arrays of an archive by name.

    Args:
        path: of the archive.
        names: of the arrays that are read, if they are there; None: all.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: a damaged archive, an array of objects, or one that declares more than the file can hold; the
            message names the file.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path}: missing; expected arrays, .npz")
    try:
        with zipfile.ZipFile(path) as archive:
            entries = archive.infolist()
            _check_number(archive, len(entries))
            size, most = sum(entry.file_size for entry in entries), RATIO * path.stat().st_size + FREE
            if size > most:
                raise ValueError(
                    f"declares {size / 1e9:.3g} GB; expected {most / 1e9:.3g} GB at most in so small a file"
                )
            named = {entry.filename.removesuffix(".npy"): entry for entry in entries}
            return {name: _read_array(archive, named[name]) for name in named if names is None or name in names}
    except (ValueError, KeyError, OSError, EOFError, RuntimeError, NotImplementedError, OverflowError, SyntaxError,
            TypeError, tokenize.TokenError, zipfile.BadZipFile, zlib.error) as error:  # fmt: skip
        raise ValueError(f"{path}: not a whole archive of arrays: {error}") from error


def _check_number(archive: zipfile.ZipFile, got: int) -> None:
    """Raise unless the archive itself says so many: damaged lengths in its directory hide arrays."""
    assert archive.fp is not None
    archive.fp.seek(-(22 + len(archive.comment)), os.SEEK_END)  # where the record of 22 bytes about the whole begins
    number = int.from_bytes(archive.fp.read(12)[-2:], "little")
    if number not in (got, 0xFFFF):  # the latter stands for more
        raise ValueError(f"lists {got} arrays, but says that it has {number}")


def _read_array(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> npt.NDArray[Any]:
    with archive.open(entry) as stream:
        version = np.lib.format.read_magic(stream)
        read_header = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
        if version not in read_header:
            raise ValueError(f"array {entry.filename} has version {version}")
        shape, _, dtype = read_header[version](stream)
        if math.prod(shape) * dtype.itemsize > entry.file_size:
            raise ValueError(f"array {entry.filename} declares shape {list(shape)}, more than the archive holds")
    with archive.open(entry) as stream:
        array: npt.NDArray[Any] = np.lib.format.read_array(stream, allow_pickle=False)
        return array
