"""Reads LAS, LAZ and COPC files (ASPRS LAS 1.4) with laspy and lazrs, whole or in parts.

A COPC file is a LAZ file whose points are sorted into an octree; its points are read in the order of the file.
Coordinates are X, Y, Z x scale + offset, in float64: UTM coordinates have more digits than float32.
Colours have 16 bits. If none is above 255, they are read as 8 bits, because many programs write them so. If all are 0,
there are none.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import torch

from torchjoint.datasets.files.columns import CloudFile, tell_not_read, unit_colors
from torchjoint.datasets.files.las_header import check_header
from torchjoint.runtime.messages import needed_for

SUFFIXES = (".las", ".laz")
#: Points that are read at a time; a chunk of LAZ has 50,000.
CHUNK = 1_000_000


class LasPoints(NamedTuple):
    """Some points of a file."""

    xyz: npt.NDArray[np.float64]  #: [n, 3]
    rgb: npt.NDArray[np.uint16] | None  #: [n, 3], as in the file


def read_las(path: Path) -> CloudFile:
    """Reads a whole file: positions, float64, and colours, if any.

    Raises:
        FileNotFoundError, ValueError: the message names the file and its error.
        ModuleNotFoundError: laspy or lazrs is not installed.
    """
    with open_las(path) as reader:
        tell_not_read(reader.header.point_format.extra_dimension_names, str(path))
        parts = list(las_points(reader, path))
    xyz = torch.from_numpy(np.concatenate([part.xyz for part in parts]))
    rgb = np.concatenate([part.rgb for part in parts if part.rgb is not None]) if parts[0].rgb is not None else None
    return CloudFile(xyz, unit_colors(rgb) if rgb is not None and rgb.any() else None)


@contextmanager
def open_las(path: Path, only_places: bool = True) -> Iterator[Any]:
    """Checks the header of a file, then opens the file as a laspy.LasReader.

    Args:
        path: of the file.
        only_places: decompress only coordinates and colours, if the file's point format allows it.

    Raises:
        FileNotFoundError, ValueError: the message names the file and its error.
        ModuleNotFoundError: laspy or lazrs is not installed.
    """
    laspy = las_library()
    check_header(path)
    wanted = laspy.DecompressionSelection.all()
    if only_places:
        kinds = laspy.DecompressionSelection
        wanted = kinds.XY_RETURNS_CHANNEL | kinds.Z | kinds.RGB
    reader = None
    try:
        with _clear_errors(path):
            reader = laspy.open(path, decompression_selection=wanted)
        yield reader
    finally:
        if reader is not None:
            reader.close()


def las_chunks(reader: Any, path: Path, count: int = CHUNK) -> Iterator[Any]:
    """The points of an open file in their order, `count` at a time, as laspy's records.

    Raises:
        ValueError: a damaged or truncated file.
    """
    left = reader.header.point_count
    while left > 0:
        with _clear_errors(path):
            chunk = reader.read_points(min(count, left))
            if len(chunk) != min(count, left):
                raise ValueError(f"truncated: {left} points are missing")
        left -= len(chunk)
        yield chunk


def las_points(reader: Any, path: Path, count: int = CHUNK) -> Iterator[LasPoints]:
    """Coordinates and colours of the points of an open file, as :func:`las_chunks`."""
    colored = "red" in set(reader.header.point_format.dimension_names)
    for chunk in las_chunks(reader, path, count):
        xyz = np.stack([chunk.x, chunk.y, chunk.z], axis=1)
        rgb = np.stack([chunk.red, chunk.green, chunk.blue], axis=1) if colored else None
        yield LasPoints(xyz.astype(np.float64, copy=False), rgb)


def las_library() -> Any:
    """The module laspy, with a backend that reads LAZ.

    Raises:
        ModuleNotFoundError: laspy or lazrs is not installed; the message says what to install.
    """
    with needed_for("reading .las and .laz", "laspy and lazrs", "torchjoint[las]"):
        import laspy
        import lazrs  # noqa: F401
    return laspy


@contextmanager
def _clear_errors(path: Path) -> Iterator[None]:
    """Turns errors of laspy and lazrs, also a panic in Rust, into a ValueError that names the file."""
    try:
        yield
    except BaseException as error:
        if not isinstance(error, Exception) and type(error).__name__ != "PanicException":
            raise
        if isinstance(error, MemoryError):
            raise
        raise ValueError(f"{path}: not a whole LAS file: {error}") from error
