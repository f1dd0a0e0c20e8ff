"""Reads PLY files (Greg Turk's Polygon File Format, 1994), ascii and binary of both byte orders; writes binary ones.

Every number is checked: a truncated file, extra data, or a word that is not a number is an error in any element.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchjoint.datasets.files.ply_ascii import read_ascii
from torchjoint.datasets.files.ply_binary import read_binary
from torchjoint.datasets.files.ply_columns import Columns, Lists
from torchjoint.datasets.files.ply_header import MAX_HEADER, parse_header
from torchjoint.runtime.files import atomic_write
from torchjoint.runtime.foreign_files import damage_is, open_file

Array = npt.NDArray[Any]

#: Names of the list of a face's vertices.
_FACE_LISTS = ("vertex_indices", "vertex_index")
_COLORS, _NORMALS = ("red", "green", "blue"), ("nx", "ny", "nz")
#: Gaussian splats (Kerbl et al. 2023): the constant term of the colour's spherical harmonics, and this basis function.
#: Their opacity is stored before a sigmoid.
_HARMONICS, _CONSTANT, _OPACITY = ("f_dc_0", "f_dc_1", "f_dc_2"), 0.5 / np.pi**0.5, "opacity"


class Ply(NamedTuple):
    """A cloud, or a mesh."""

    points: Tensor  #: [N, 3] metres, float32 or float64 as in the file
    colors: Tensor | None  #: [N, 3] float32 RGB in [0, 1]
    normals: Tensor | None  #: [N, 3] float32
    faces: Tensor | None  #: [F, 3] int64; polygons are cut into triangles from their first vertex
    opacities: Tensor | None = None  #: [N] float32 in [0, 1], of Gaussian splats


def read_ply(path: Path) -> Ply:
    """Reads the vertices and faces of a PLY file; of other elements only the size is checked.

    Raises:
        FileNotFoundError, ValueError: the message names the file and its error; sizes in the header are compared
            with the file's size before memory is allocated.
    """
    elements = _read_elements(path)
    with damage_is(str(path)):
        return _assembled(elements)


def read_vertex_property(path: Path, name: str) -> npt.NDArray[np.int64] | None:
    """Reads an integer property of the vertices, [N]; None if there is no property of this name.

    Raises:
        FileNotFoundError, ValueError: as :func:`read_ply`; also if the property is a list, or not of integers.
    """
    vertex = _read_elements(path).get("vertex", Columns.of({}, 0))
    if name not in vertex.kinds:
        return None
    if vertex.kinds[name].kind not in "iu":
        raise ValueError(f"{path}: property {name}: expected integers, got {vertex.kinds[name]}")
    with damage_is(str(path)):
        return vertex.stacked({name: ((name,), np.int64, 1)})[name][:, 0]


def _read_elements(path: Path) -> dict[str, Columns]:
    with open_file(path, "a point cloud, .ply") as stream:
        start = stream.read(MAX_HEADER)
    with damage_is(str(path)):
        header = parse_header(start)
        return (read_ascii if header.encoding == "ascii" else read_binary)(path, header)


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


def _assembled(elements: Mapping[str, Columns]) -> Ply:
    vertex = elements.get("vertex", Columns.of({}, 0))
    missing = [name for name in "xyz" if not vertex.has_numbers(name)]
    if missing:
        raise ValueError(f"expected an element vertex with properties x, y and z; {', '.join(missing)} missing")
    if not vertex.rows:
        raise ValueError("no points")
    narrow = all((vertex.kinds[name].kind, vertex.kinds[name].itemsize) == ("f", 4) for name in "xyz")
    wanted: dict[str, tuple[tuple[str, ...], npt.DTypeLike, float]] = {
        "points": (tuple("xyz"), np.float32 if narrow else np.float64, 1)
    }
    are_splats = not vertex.has_numbers(_COLORS) and vertex.has_numbers(_HARMONICS)
    if are_splats:
        wanted["colors"] = (_HARMONICS, np.float32, 1)
        if vertex.has_numbers((_OPACITY,)):
            wanted["opacities"] = ((_OPACITY,), np.float32, 1)
    elif vertex.has_numbers(_COLORS):
        wanted["colors"] = (_COLORS, np.float32, _white([vertex.kinds[name] for name in _COLORS]))
    if vertex.has_numbers(_NORMALS):
        wanted["normals"] = (_NORMALS, np.float32, 1)
    made = {name: torch.from_numpy(array) for name, array in vertex.stacked(wanted).items()}
    colors, normals = made.get("colors"), made.get("normals")
    if are_splats and colors is not None:
        colors = (0.5 + _CONSTANT * colors).clamp(0, 1)
    if normals is not None and not normals.any():
        normals = None  # some programs, such as those for splats, write zeros where they have no normals
    opacities = made["opacities"][:, 0].sigmoid() if "opacities" in made else None
    return Ply(made["points"], colors, normals, _faces(elements, vertex.rows), opacities)


def _white(kinds: Sequence[np.dtype[Any]]) -> float:
    """The number of full brightness."""
    kind = kinds[0] if len({(one.kind, one.itemsize) for one in kinds}) == 1 else np.dtype(np.uint8)
    return 1 if kind.kind == "f" else int(np.iinfo(kind).max)


def _faces(elements: Mapping[str, Columns], num_points: int) -> Tensor | None:
    face = elements.get("face", Columns.of({}, 0))
    name = next((name for name in _FACE_LISTS if name in face.kinds), None)
    if name is None or not face.rows:
        return None
    lists = next(block[name] for _, block in face.blocks())  # rows with lists are one block
    if isinstance(lists, Lists):
        stacked = _fans(lists)
    else:  # all of one length
        corners = lists.reshape(len(lists), -1)
        triangles = np.empty((len(lists), max(corners.shape[1] - 2, 0), 3), np.int64)
        for k in range(triangles.shape[1]):
            for place, corner in enumerate((0, k + 1, k + 2)):
                triangles[:, k, place] = corners[:, corner]
        stacked = triangles.reshape(-1, 3)
    if not len(stacked):
        return None
    if not 0 <= stacked.min() <= stacked.max() < num_points:
        raise ValueError(
            f"element face: expected vertices in [0, {num_points}), got {stacked.min()} to {stacked.max()}"
        )
    return torch.from_numpy(stacked)


def _fans(lists: Lists) -> Array:
    """The triangles [F, 3] int64 of polygons, from the first corner of each."""
    count = np.maximum(lists.lengths - 2, 0)
    start = np.repeat(np.cumsum(lists.lengths) - lists.lengths, count)
    second = start + 1 + np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    return np.stack([lists.values[start], lists.values[second], lists.values[second + 1]], axis=1).astype(np.int64)
