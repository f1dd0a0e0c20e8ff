"""Writes a copy of a LAS or LAZ file with one more dimension: the label of each point."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from torchjoint.datasets.files.las import las_chunks, las_library, open_las

#: The name of the dimension.
DIMENSION = "superpoint"
#: Records that describe how a file stores its points; they do not fit the copy, which stores them in another way.
_STORAGE = ("LasZipVlr", "CopcInfoVlr", "CopcHierarchyVlr")


def check_dimension(path: Path) -> None:
    """Checks that a file does not have the dimension yet.

    Raises:
        ValueError: the file has the dimension.
    """
    with open_las(path) as reader:
        if DIMENSION in set(reader.header.point_format.dimension_names):
            raise ValueError(f"{path}: expected no dimension {DIMENSION}, got one; remove it first")


def write_labelled(
    path: Path, out: Path, labels: npt.NDArray[Any], progress: Callable[[int], object] = lambda count: None
) -> int:
    """Copies a file, with all dimensions and records (such as the coordinate system), in the same order.

    Args:
        path: .las or .laz. A .copc.laz becomes a plain .laz: its points keep their order, but lose the octree.
        out: .las or .laz; the suffix determines the format.
        labels: [N or more] unsigned integers, of 32 or 64 bits; may be mapped from disk.
        progress: is called with the number of points of each part.

    Returns:
        N, the number of points.
    """
    laspy, done = las_library(), 0
    with open_las(path, only_places=False) as reader:
        header = _header(laspy, reader.header, labels.dtype)
        with laspy.open(out, "w", header=header, do_compress=out.suffix.lower() == ".laz") as writer:
            for chunk in las_chunks(reader, path):
                part = labels[done : done + len(chunk)]
                writer.write_points(_with_label(laspy, chunk, writer.header, part))
                done += len(chunk)
                progress(len(chunk))
            extended = [record for record in reader.evlrs or () if type(record).__name__ not in _STORAGE]
            if extended:
                writer.write_evlrs(laspy.vlrs.vlrlist.VLRList(extended))
    return done


def _header(laspy: Any, given: Any, dtype: np.dtype[Any]) -> Any:
    header = deepcopy(given)
    header.vlrs = [record for record in header.vlrs if type(record).__name__ not in _STORAGE]
    header.evlrs = None
    header.add_extra_dim(laspy.ExtraBytesParams(DIMENSION, dtype, "superpoint of torchjoint"))
    return header


def _with_label(laspy: Any, chunk: Any, header: Any, labels: npt.NDArray[Any]) -> Any:
    record = laspy.ScaleAwarePointRecord.zeros(len(chunk), header=header)
    for name in chunk.array.dtype.names:  # the stored numbers, not scaled coordinates: an exact copy
        record.array[name] = chunk.array[name]
    record.array[DIMENSION] = labels
    return record
