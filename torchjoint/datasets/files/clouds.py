"""Reads a single point cloud from a file: .ply, .pcd, .npy, .npz, .bin (KITTI), .xyz, .las, .laz, .e57, a mesh."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchjoint.datasets.files import meshes
from torchjoint.datasets.files.readers import opaque, read_array, read_mesh
from torchjoint.runtime.archives import read_archive
from torchjoint.runtime.foreign_files import damage_is, present
from torchjoint.scene.checks import Invalid, kept_points

#: Row lengths that are tried for a LiDAR scan; rows that are examined, and the fewest rows that allow a decision.
COLUMNS, ROWS, LEAST_ROWS = (3, 4, 5, 6, 7), 1 << 16, 100

#: An array with more columns than this, and more columns than rows, is transposed: its columns are the points.
MOST_COLUMNS = 16

#: Another row length is more plausible if it reduces the median step between points below this share.
MUCH = 0.25

#: Letters of columns: positions, colours, normals; and the suffixes of files of rows, which may have them.
GROUPS = ("xyz", "rgb", "n")
LETTERED = (".npy", ".xyz", ".txt", ".bin")

#: What :func:`read_mesh` reads.
MESHES = (".ply", ".pcd", ".las", ".laz", ".e57", *meshes.SUFFIXES)
SUFFIXES = (*MESHES, ".npy", ".npz", ".bin", ".xyz", ".txt")


class CloudFile(NamedTuple):
    """The contents of a point cloud file."""

    points: Tensor  #: [N, 3]
    colors: Tensor | None = None  #: [N, 3] RGB in [0, 1], or uint8
    normals: Tensor | None = None  #: [N, 3]
    faces: Tensor | None = None  #: [F, 3] int64, triangles of a mesh
    opacities: Tensor | None = None  #: [N] in [0, 1], of Gaussian splats


def read_cloud_file(
    path: Path, columns: int | str | None = None, invalid: Invalid = "refuse", least_opacity: float = 0.0
) -> CloudFile:
    """Reads a cloud; the suffix of the file gives its format.

    * .ply, .pcd: positions; colours and normals, if any; the triangles of a .ply mesh;
    * .obj, .glb, .gltf, .off, .stl: vertices, triangles; colours, if any;
    * .las, .laz (also COPC), .e57: positions, float64; colours, if any; all scans of an .e57, in its world frame;
    * .npz: array `points` and, if any, arrays `colors`, `normals`, `faces`;
    * .npy, .xyz, .txt: one row per point, x y z first; columns 4 to 6 are colours, if all are in 0-255 (or 0-1), else
      they are left out, as all after them are; a warning tells what is left out;
    * .pcd.bin: nuScenes' LiDAR scans, rows of 5 float32: x y z intensity ring;
    * other .bin: KITTI's LiDAR scans, rows of 4 float32: x y z reflectance.

    Args:
        path: of the file.
        columns: numbers in a row of a .bin file, if other than above. Or a letter for each number in a row of a .bin,
            .npy, .xyz or .txt file: x y z, r g b, nnn (a normal); others are left out: "xyzrgbl".
        invalid: what becomes of points that are NaN or infinite; a mesh with such points loses its triangles.
        least_opacity: fainter Gaussian splats are left out, with a warning.

    Raises:
        FileNotFoundError, ValueError: the message names the file and its error.
    """
    read = _read(path, columns)
    valid = kept_points(read.points, str(path), invalid) & opaque(read.opacities, least_opacity, path)
    if bool(valid.all()):
        return read
    colors, normals = (None if of is None else of[valid] for of in (read.colors, read.normals))
    return CloudFile(read.points[valid], colors, normals)


def _read(path: Path, columns: int | str | None) -> CloudFile:
    """The cloud with its invalid points."""
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise ValueError(f"{path}: expected a file that ends in {', '.join(SUFFIXES)}")
    present(path, "a point cloud")
    if isinstance(columns, str):
        if suffix not in LETTERED:
            raise ValueError(f"{path}: expected a file that ends in {', '.join(LETTERED)}, for columns {columns!r}")
        if [columns.count(letter) for letter in "xyz"] != [1, 1, 1] or not _is_whole(columns):
            raise ValueError(f"columns: expected x, y, z, and r, g, b or nnn if there are any, got {columns!r}")
    if suffix in MESHES:
        return CloudFile(*read_mesh(path))
    if isinstance(columns, int) and (suffix != ".bin" or columns < 3):
        raise ValueError(f"{path}: expected at least 3 columns, and a file that ends in .bin, got {columns} columns")
    if suffix == ".bin":
        if isinstance(columns, str):
            return _from_letters(read_scan(path, len(columns), "keep").numpy(), columns)
        return CloudFile(_read_bin(path, columns)[:, :3])
    with damage_is(f"{path}: not a whole {suffix} cloud", OSError):
        if suffix == ".npz":
            return _from_archive(path)
        rows = read_array(path).numpy() if suffix == ".npy" else np.loadtxt(path, ndmin=2)
        return _from_letters(rows, columns) if isinstance(columns, str) else _from_rows(rows)


def _read_bin(path: Path, columns: int | None) -> Tensor:
    """A LiDAR scan; if the number of columns was not given, it must be plausible."""
    usual = 5 if path.name.lower().endswith(".pcd.bin") else 4
    rows = read_scan(path, columns or usual, "keep")
    better = None if columns is not None else likelier_columns(rows)
    if better is not None:
        raise ValueError(
            f"{path}: expected rows of {usual} float32, but rows of {better} are more plausible: consecutive points "
            f"are then near each other; give the number of columns (--columns {better}, or --columns {usual})"
        )
    return rows


def likelier_columns(rows: Tensor) -> int | None:
    """The row length that is much more plausible for a LiDAR scan than that of its rows [N, C]; or None.

    A LiDAR rotates, so consecutive points are near each other. Rows of a wrong length mix up the columns.
    """
    values, steps = rows.flatten(), {}
    for columns in (rows.shape[1], *(count for count in COLUMNS if len(values) % count == 0)):
        xyz = values[: ROWS * columns].reshape(-1, columns)[:, :3].double()
        step, size = (xyz[1:] - xyz[:-1]).norm(dim=1), (xyz - xyz.median(0).values).norm(dim=1)
        steps[columns] = float(step.median() / size.median()) if len(xyz) >= LEAST_ROWS and size.median() > 0 else 1.0
    best = min(steps, key=lambda columns: (steps[columns], columns))
    return best if steps[best] < MUCH * steps[rows.shape[1]] else None


def read_scan(path: Path, columns: int, invalid: Invalid = "refuse") -> Tensor:
    """Reads a LiDAR scan of KITTI or nuScenes, float32 rows x, y, z, ...; returns [N, columns].

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the size of the file does not fit, or a point is not finite.
    """
    present(path, "a LiDAR scan")
    size = path.stat().st_size
    if size == 0 or size % (4 * columns):
        raise ValueError(f"{path}: expected rows of {columns} float32, {4 * columns} bytes each, got {size} bytes")
    rows = torch.from_numpy(np.fromfile(path, dtype="<f4").reshape(-1, columns))
    return rows[kept_points(rows[:, :3], str(path), invalid)]


def _from_archive(path: Path) -> CloudFile:
    values = {name: torch.from_numpy(array) for name, array in read_archive(path).items()}
    if "points" not in values:
        raise ValueError(f"expected an array `points`, got {', '.join(values) or 'none'}")
    count = len(values["points"]) if values["points"].shape[1:] == (3,) else -1
    for name in ("points", "colors", "normals"):
        if name in values and values[name].shape != (count, 3):
            raise ValueError(f"{name}: expected a row of three numbers for each point, got {[*values[name].shape]}")
    return CloudFile(values["points"], *map(values.get, ("colors", "normals", "faces")))


def _from_rows(rows: npt.NDArray[Any]) -> CloudFile:
    if rows.ndim != 2 or rows.shape[1] < 3:
        raise ValueError(f"expected a row of x y z for each point, got shape {list(rows.shape)}")
    if rows.shape[1] > max(MOST_COLUMNS, rows.shape[0]):
        raise ValueError(f"expected a row of x y z for each point, got shape {list(rows.shape)}: transpose the array")
    values = torch.from_numpy(np.ascontiguousarray(rows)).to(torch.float64)
    colors = values[:, 3:6] if rows.shape[1] >= 6 else None
    if colors is not None and colors.numel() and not (float(colors.min()) >= 0 and float(colors.max()) <= 255):
        colors = None  # normals, for example
    used = 3 if colors is None else 6
    if rows.shape[1] > used:
        what = "x y z" if colors is None else "x y z and colours"
        warnings.warn(
            f"of {rows.shape[1]} columns, the first {used} are read, {what}; the rest is left out; --columns "
            "xyz... names others",
            stacklevel=2,
        )
    return CloudFile(values[:, :3], None if colors is None else unit_colors(colors.float()))


def _is_whole(letters: str) -> bool:
    """Whether colours and normals have three columns each, if any."""
    return [letters.count(letter) for letter in "rgb"] in ([0] * 3, [1] * 3) and letters.count("n") in (0, 3)


def _from_letters(rows: npt.NDArray[Any], letters: str) -> CloudFile:
    """Rows whose columns have a letter each."""
    if rows.ndim != 2 or rows.shape[1] != len(letters):
        raise ValueError(f"expected rows of {len(letters)} numbers, {letters!r}, got shape {list(rows.shape)}")
    values = torch.from_numpy(np.ascontiguousarray(rows)).to(torch.float64)
    x, r, n = ([place for one in group for place, letter in enumerate(letters) if letter == one] for group in GROUPS)
    colors, normals = (values[:, places].float() if places else None for places in (r, n))
    return CloudFile(values[:, x], None if colors is None else unit_colors(colors), normals)


def unit_colors(colors: Tensor) -> Tensor:
    """Colours of 0 to 255 as colours of 0 to 1; those that are in 0 to 1 already stay."""
    return colors / 255 if colors.numel() and float(colors.max()) > 1 else colors
