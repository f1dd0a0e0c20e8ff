"""Reads PLY files (Greg Turk's Polygon File Format, 1994), ascii and binary of both byte orders; writes binary ones.

Each number of the file is accounted for: what is cut, too long or not a number is an error, wherever it is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchjoint.datasets.ply_ascii import read_ascii
from torchjoint.datasets.ply_header import MAX_HEADER, Element, PlyHeader, list_arrays, parse_header
from torchjoint.runtime.files import atomic_write

Array = npt.NDArray[Any]

#: Names of the list of a face's vertices.
_FACE_LISTS = ("vertex_indices", "vertex_index")


class Ply(NamedTuple):
    """A cloud, or a mesh."""

    points: Tensor  #: [N, 3] metres, float32 or float64 as in the file
    colors: Tensor | None  #: [N, 3] float32 RGB in [0, 1]
    normals: Tensor | None  #: [N, 3] float32
    faces: Tensor | None  #: [F, 3] int64; polygons are cut into triangles from their first vertex


def read_ply(path: Path) -> Ply:
    """Reads the vertices and faces of a PLY file; other elements are checked for their size and left out.

    Raises:
        FileNotFoundError, ValueError: naming the file and its error; sizes in the header are compared with the file's
            size before memory is allocated.
    """
    elements = _read_elements(path)
    try:
        return _assembled(elements)
    except (ValueError, OverflowError) as error:
        raise ValueError(f"{path}: {error}") from error


def read_vertex_property(path: Path, name: str) -> npt.NDArray[np.int64] | None:
    """An integer property of the vertices, [N]; None if there is none of this name.

    Raises:
        FileNotFoundError, ValueError: as :func:`read_ply`; or the property is a list, or not of integers.
    """
    values = _read_elements(path).get("vertex", {}).get(name)
    if values is None:
        return None
    if values.dtype.kind not in "iu":
        raise ValueError(f"{path}: property {name}: expected integers, got {values.dtype}")
    return values.astype(np.int64)


def _read_elements(path: Path) -> dict[str, Mapping[str, Array]]:
    if not path.is_file():
        raise FileNotFoundError(f"{path}: missing; expected a point cloud, .ply")
    data = np.fromfile(path, np.uint8)
    try:
        header = parse_header(data[:MAX_HEADER].tobytes())
        return read_ascii(data, header) if header.encoding == "ascii" else _read_binary(data, header)
    except (ValueError, OverflowError) as error:
        raise ValueError(f"{path}: {error}") from error


def write_cloud(path: Path, points: Tensor, colors: Tensor | None = None, labels: Tensor | None = None) -> None:
    """Writes a binary PLY atomically: equal arguments give equal bytes.

    Args:
        path: of the file.
        points: [N, 3], as float, or double if they are float64.
        colors: [N, 3] in [0, 1], as uchar red green blue.
        labels: [N] integers, as int label.
    """
    kind = "f8" if points.dtype == torch.float64 else "f4"
    fields = [(name, f"<{kind}") for name in "xyz"]
    fields += [] if colors is None else [(name, "u1") for name in ("red", "green", "blue")]
    fields += [] if labels is None else [("label", "<i4")]
    rows = np.empty(len(points), dtype=np.dtype(fields))
    for axis, name in enumerate("xyz"):
        rows[name] = points[:, axis].numpy()
    if colors is not None:
        bytes_ = (colors.clamp(0, 1) * 255).round().to(torch.uint8).numpy()
        for axis, name in enumerate(("red", "green", "blue")):
            rows[name] = bytes_[:, axis]
    if labels is not None:
        rows["label"] = labels.to(torch.int32).numpy()
    names = {"<f4": "float", "<f8": "double", "u1": "uchar", "<i4": "int"}
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}"]
    lines += [f"property {names[kind]} {name}" for name, kind in fields]
    with atomic_write(path) as partial, partial.open("wb") as stream:
        stream.write(("\n".join([*lines, "end_header"]) + "\n").encode())
        stream.write(rows.tobytes())


def _read_binary(data: Array, header: PlyHeader) -> dict[str, Mapping[str, Array]]:
    """Views of the file's bytes: only columns that are asked for are copied."""
    place = header.size
    elements: dict[str, Mapping[str, Array]] = {}
    for element in header.elements:
        if not element.properties:
            continue
        if element.lists:
            elements[element.name], place = _rows_with_lists(data, place, element, header)
            continue
        dtype = element.dtype(header.byte_order)
        _check_rest(data, place, dtype.itemsize * element.rows, element)
        rows = np.frombuffer(data, dtype, element.rows, place)
        elements[element.name] = {name: rows[name] for name in element.names}
        place += rows.nbytes
    if data[place:].tobytes().strip():
        raise ValueError(f"expected the end at byte {place}, got {len(data) - place} more bytes")
    return elements


def _rows_with_lists(data: Array, place: int, element: Element, header: PlyHeader) -> tuple[dict[str, Array], int]:
    """The rows of an element with lists, as object arrays or [count, k] where all lists have one length."""
    smallest = sum(np.dtype(p.length or p.kind).itemsize for p in element.properties)
    _check_rest(data, place, smallest * element.rows, element)
    if element.rows == 0:
        return {}, place
    lengths = _lengths(data, place, element, header)
    dtype = element.dtype(header.byte_order, lengths)
    if dtype.itemsize * element.rows <= len(data) - place:
        rows = np.frombuffer(data, dtype, element.rows, place)
        if all((rows[f"#{name}"] == length).all() for name, length in lengths.items()):
            return {name: rows[name] for name in element.names}, place + rows.nbytes
    columns: dict[str, list[Any]] = {name: [] for name in element.names}
    for _ in range(element.rows):
        row = np.frombuffer(*_one_row(data, place, element, header))[0]
        for name in element.names:
            columns[name].append(row[name])
        place += row.nbytes
    return list_arrays(columns, element), place


def _one_row(data: Array, place: int, element: Element, header: PlyHeader) -> tuple[Array, np.dtype[Any], int, int]:
    dtype = element.dtype(header.byte_order, _lengths(data, place, element, header))
    _check_rest(data, place, dtype.itemsize, element)
    return data, dtype, 1, place


def _lengths(data: Array, place: int, element: Element, header: PlyHeader) -> dict[str, int]:
    """The lengths of the lists in the row at `place`."""
    lengths = {}
    for one in element.properties:
        if one.length is not None:
            _check_rest(data, place, np.dtype(one.length).itemsize, element)
            length = int(np.frombuffer(data, np.dtype(header.byte_order + one.length), 1, place)[0])
            if length < 0:
                raise ValueError(f"element {element.name}: a list of {length} numbers")
            lengths[one.name] = length
            place += np.dtype(one.length).itemsize + length * np.dtype(one.kind).itemsize
        else:
            place += np.dtype(one.kind).itemsize
        _check_rest(data, place, 0, element)
    return lengths


def _check_rest(data: Array, place: int, size: int, element: Element) -> None:
    if size > len(data) - place:
        raise ValueError(
            f"truncated: {element.rows} of element {element.name} need {size} bytes at byte {place}, "
            f"got {max(0, len(data) - place)}"
        )


def _assembled(elements: Mapping[str, Mapping[str, Array]]) -> Ply:
    vertex = elements.get("vertex", {})
    missing = [name for name in "xyz" if name not in vertex or vertex[name].dtype == object]
    if missing:
        raise ValueError(f"expected an element vertex with properties x, y and z; {', '.join(missing)} missing")
    points = _columns(vertex, "xyz")
    assert points is not None
    if not len(points):
        raise ValueError("no points")
    normals = _columns(vertex, ("nx", "ny", "nz"))
    return Ply(points, _colors(vertex), None if normals is None else normals.float(), _faces(elements, len(points)))


def _columns(values: Mapping[str, Array], names: tuple[str, ...] | str) -> Tensor | None:
    """[N, k]: float32 if all of them are, else float64; None if one is missing."""
    if any(name not in values or values[name].dtype == object for name in names):
        return None
    narrow = all((values[name].dtype.kind, values[name].dtype.itemsize) == ("f", 4) for name in names)
    return _stacked([values[name] for name in names], np.float32 if narrow else np.float64)


def _stacked(columns: Sequence[Array], dtype: npt.DTypeLike) -> Tensor:
    """[N, k]: each number is copied once."""
    stacked = np.empty((len(columns[0]), len(columns)), dtype)
    for place, column in enumerate(columns):
        stacked[:, place] = column
    return torch.from_numpy(stacked)


def _colors(vertex: Mapping[str, Array]) -> Tensor | None:
    names = ("red", "green", "blue")
    if any(name not in vertex or vertex[name].dtype == object for name in names):
        return None
    columns = [vertex[name] for name in names]
    kinds = {column.dtype for column in columns}
    (kind,) = kinds if len(kinds) == 1 else (np.dtype(np.uint8),)
    white = 1 if kind.kind == "f" else np.iinfo(kind).max
    if all(column.dtype == np.uint8 for column in columns):
        shares = (np.arange(256) / white).astype(np.float32)  # what the division gives
        return _stacked([shares[column] for column in columns], np.float32)
    return (_stacked(columns, np.float64) / white).float()


def _faces(elements: Mapping[str, Mapping[str, Array]], num_points: int) -> Tensor | None:
    face = elements.get("face", {})
    lists = next((face[name] for name in _FACE_LISTS if name in face), None)
    if lists is None or not len(lists):
        return None
    if lists.dtype != object:  # all of one length
        corners = lists.reshape(len(lists), -1)
        triangles = np.empty((len(lists), max(corners.shape[1] - 2, 0), 3), np.int64)
        for k in range(triangles.shape[1]):
            for place, corner in enumerate((0, k + 1, k + 2)):
                triangles[:, k, place] = corners[:, corner]
        stacked = triangles.reshape(-1, 3)
    else:
        cut = [[one[0], one[k], one[k + 1]] for one in lists for k in range(1, len(one) - 1)]
        stacked = np.array(cut, dtype=np.int64).reshape(-1, 3)
    if not len(stacked):
        return None
    if not 0 <= stacked.min() <= stacked.max() < num_points:
        raise ValueError(
            f"element face: expected vertices in [0, {num_points}), got {stacked.min()} to {stacked.max()}"
        )
    return torch.from_numpy(stacked)
