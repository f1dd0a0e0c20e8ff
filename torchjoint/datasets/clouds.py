"""Reads a single point cloud from a file: .ply, .pcd, .npy, .npz, .bin (KITTI), .xyz."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple
from zipfile import BadZipFile

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchjoint.datasets.files import read_cloud

SUFFIXES = (".ply", ".pcd", ".npy", ".npz", ".bin", ".xyz", ".txt")


class CloudFile(NamedTuple):
    """The contents of a point cloud file."""

    points: Tensor  #: [N, 3]
    colors: Tensor | None = None  #: [N, 3] RGB in [0, 1], or uint8
    normals: Tensor | None = None  #: [N, 3]
    faces: Tensor | None = None  #: [F, 3] int64, triangles of a mesh


def read_cloud_file(path: Path) -> CloudFile:
    """Reads a cloud; the suffix of the file gives its format.

    * .ply, .pcd: positions; colours and normals, if any; the triangles of a .ply mesh;
    * .npz: array `points` and, if any, arrays `colors`, `normals`, `faces`;
    * .npy, .xyz, .txt: one row per point, x y z first; six columns are x y z and colours (0-255, or 0-1);
    * .bin: KITTI's LiDAR scans, float32 x y z reflectance.

    Raises:
        FileNotFoundError, ValueError: naming the file and its error.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise ValueError(f"{path}: expected a file that ends in {', '.join(SUFFIXES)}")
    if not path.is_file():
        raise FileNotFoundError(f"{path}: missing; expected a point cloud")
    if suffix in (".ply", ".pcd"):
        points, colors, normals = read_cloud(path)
        return CloudFile(points, colors, normals, _triangles(path) if suffix == ".ply" else None)
    if suffix == ".bin":
        return CloudFile(read_scan(path, 4)[:, :3])
    try:
        if suffix == ".npz":
            return _from_archive(path)
        rows = np.load(path, allow_pickle=False) if suffix == ".npy" else np.loadtxt(path, ndmin=2)
        return _from_rows(rows)
    except (ValueError, KeyError, OSError, EOFError, BadZipFile, TypeError) as error:
        raise ValueError(f"{path}: not a whole {suffix} cloud: {error}") from error


def read_scan(path: Path, columns: int) -> Tensor:
    """Reads a LiDAR scan of KITTI or nuScenes, float32 rows x, y, z, ...; returns [N, columns] with finite x, y, z.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the size of the file does not fit, or a point is not finite.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path}: missing; expected a LiDAR scan")
    size = path.stat().st_size
    if size == 0 or size % (4 * columns):
        raise ValueError(f"{path}: expected rows of {columns} float32, {4 * columns} bytes each, got {size} bytes")
    rows = np.fromfile(path, dtype="<f4").reshape(-1, columns)
    bad = int((~np.isfinite(rows[:, :3])).any(1).sum())
    if bad:
        raise ValueError(f"{path}: {bad} of {len(rows)} points are NaN or infinite")
    return torch.from_numpy(rows)


def _from_archive(path: Path) -> CloudFile:
    with path.open("rb") as stream, np.load(stream, allow_pickle=False) as arrays:
        values = {name: torch.from_numpy(arrays[name]) for name in arrays.files}
    if "points" not in values:
        raise ValueError(f"expected an array `points`, got {', '.join(values) or 'none'}")
    return CloudFile(*(values.get(name) for name in CloudFile._fields))  # type: ignore[arg-type]


def _from_rows(rows: npt.NDArray[Any]) -> CloudFile:
    if rows.ndim != 2 or rows.shape[1] < 3:
        raise ValueError(f"expected a row of x y z for each point, got shape {list(rows.shape)}")
    values = torch.from_numpy(np.ascontiguousarray(rows)).to(torch.float64)
    colors = values[:, 3:6].float() if rows.shape[1] == 6 else None
    if colors is not None and colors.numel() and float(colors.max()) > 1:
        colors = colors / 255
    return CloudFile(values[:, :3], colors)


def _triangles(path: Path) -> Tensor | None:
    with path.open("rb") as stream:
        header = stream.read(4096).split(b"end_header")[0]
    if b"element face" not in header:
        return None
    import open3d

    with open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error):
        faces = np.asarray(open3d.io.read_triangle_mesh(str(path)).triangles)
    return torch.from_numpy(faces.astype(np.int64)) if len(faces) else None
