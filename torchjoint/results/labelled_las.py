"""Writes a copy of a LAS or LAZ file with more dimensions, such as the label of each point. All else stays."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy.typing as npt

from torchjoint.datasets.files.las import las_chunks, las_library, open_las

#: Records that describe how a file stores its points; they do not fit the copy, which stores them in another way.
_STORAGE = ("LasZipVlr", "CopcInfoVlr", "CopcHierarchyVlr")


def check_dimension(path: Path, name: str) -> None:
    """Checks that a file does not have a dimension yet.

    Raises:
        ValueError: the file has it.
    """
    with open_las(path) as reader:
        if name in set(reader.header.point_format.dimension_names):
            raise ValueError(f"{path}: expected no dimension {name}, got one; remove it first")


def write_labelled(
    path: Path,
    out: Path,
    columns: Mapping[str, npt.NDArray[Any]],
    progress: Callable[[int], object] = lambda count: None,
) -> int:
    """Copies a file, with all dimensions and records (such as the coordinate system), in the same order.

    Args:
        path: .las or .laz. A .copc.laz becomes a plain .laz: its points keep their order, but lose the octree.
        out: .las or .laz; the suffix determines the format.
        columns: new dimensions by name: [N or more] numbers; they may be mapped from disk.
        progress: is called with the number of points of each part.

    Returns:
        N, the number of points.
    """
    laspy, done = las_library(), 0
    with open_las(path, only_places=False) as reader:
        header = _header(laspy, reader.header, columns)
        with laspy.open(out, "w", header=header, do_compress=out.suffix.lower() == ".laz") as writer:
            for chunk in las_chunks(reader, path):
                record = laspy.ScaleAwarePointRecord.zeros(len(chunk), header=writer.header)
                for name in chunk.array.dtype.names:  # the stored numbers, not scaled coordinates: an exact copy
                    record.array[name] = chunk.array[name]
                for name, values in columns.items():
                    record.array[name] = values[done : done + len(chunk)]
                writer.write_points(record)
                done += len(chunk)
                progress(len(chunk))
            extended = [record for record in reader.evlrs or () if type(record).__name__ not in _STORAGE]
            if extended:
                writer.write_evlrs(laspy.vlrs.vlrlist.VLRList(extended))
    return done


def _header(laspy: Any, given: Any, columns: Mapping[str, npt.NDArray[Any]]) -> Any:
    header = deepcopy(given)
    header.vlrs = [record for record in header.vlrs if type(record).__name__ not in _STORAGE]
    header.evlrs = None
    for name, values in columns.items():
        header.add_extra_dim(laspy.ExtraBytesParams(name, values.dtype, "of torchjoint"))
    return header
