"""Reads a single point cloud from a file: .ply, .pcd, .npy, .npz, .bin (KITTI), .xyz, .las, .laz, .e57, a mesh."""

import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from torchjoint.datasets.files import las, meshes, text_clouds
from torchjoint.datasets.files.columns import CloudFile, cloud_of, repaired, tell_not_read
from torchjoint.datasets.files.e57 import read_e57
from torchjoint.datasets.files.pcd import read_pcd
from torchjoint.datasets.files.ply import read_ply
from torchjoint.datasets.files.readers import read_array
from torchjoint.datasets.files.text_clouds import cloud_of_letters, cloud_of_rows, read_text_cloud
from torchjoint.runtime import bounds
from torchjoint.runtime.archives import read_archive
from torchjoint.runtime.foreign_files import damage_is, present
from torchjoint.scene.checks import Beams, Invalid, kept_points, tell_degrees

#: Row lengths that are tried for a LiDAR scan; rows that are examined, and the fewest rows that allow a decision.
COLUMNS, ROWS, LEAST_ROWS = (3, 4, 5, 6, 7), 1 << 16, 100

#: Another row length is more plausible if it reduces the median step between points below this share.
LOWER_STEP = 0.25

#: Files of rows, whose columns may have letters.
LETTERED = (".npy", ".bin", *text_clouds.SUFFIXES)

_READERS: dict[str, Callable[[Path], CloudFile]] = {
    ".ply": read_ply,
    ".pcd": lambda path: read_pcd(path).cloud(str(path)),
    ".e57": read_e57,
    **dict.fromkeys(las.SUFFIXES, las.read_las),
    **dict.fromkeys(meshes.SUFFIXES, meshes.read_mesh_file),
}
SUFFIXES = (*_READERS, ".npy", ".npz", ".bin", *text_clouds.SUFFIXES)


def read_cloud_file(
    path: Path, columns: int | str | None = None, invalid: Invalid = "refuse", least_opacity: float = 0.0
) -> CloudFile:
    """Reads a cloud; the suffix of the file gives its format.

    * .ply, .pcd: positions; colours and normals, if any; the triangles of a .ply mesh;
    * .obj, .glb, .gltf, .off, .stl: vertices, triangles; colours, if any;
    * .las, .laz (also COPC), .e57: positions, float64; colours, if any; all scans of an .e57, in its world frame;
    * .npz: array `points` and, if any, arrays `colors`, `normals`, `faces`;
    * .npy, .xyz, .txt, .asc, .csv, .pts: one row per point, x y z first, or names of the columns above; see
      :mod:`torchjoint.datasets.files.text_clouds`;
    * .pcd.bin: nuScenes' LiDAR scans, rows of 5 float32: x y z intensity ring;
    * other .bin: KITTI's LiDAR scans, rows of 4 float32: x y z reflectance.

    Args:
        path: of the file.
        columns: numbers in a row of a .bin file, if other than above. Or a letter for each number in a row of a .bin,
            .npy, .xyz or .txt file: x y z, r g b, nnn (a normal); others are left out: "xyzrgbl".
        invalid: what becomes of points that are NaN or infinite; a mesh loses the triangles of such points. "keep"
            keeps beams without return, too: many points at (0, 0, 0), which are left out otherwise, with a warning.
        least_opacity: fainter Gaussian splats are left out, with a warning.
    """
    read = _read(path, columns)
    beams: Beams = "keep" if invalid == "keep" or read.faces is not None else "drop many"
    read = repaired(read.chosen(kept_points(read.points, str(path), invalid, beams)), str(path))
    tell_degrees(read.points, str(path))
    return read if read.opacities is None else read.chosen(_opaque(read.opacities, least_opacity, path))


def up_of(path: Path) -> Tensor | None:
    """The upward direction [3] in a file's coordinates: y in glTF, z in a survey's system; None: they do not tell."""
    suffix = path.suffix.lower()
    if suffix in las.SUFFIXES and las.epsg_of(path) is not None:
        return torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    return torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64) if suffix in (".glb", ".gltf") else None


def _opaque(opacities: Tensor, least: float, path: Path) -> Tensor:
    """Which Gaussian splats [N] are visible enough to be a part of a surface, [N] bool."""
    enough = opacities >= least
    if not bool(enough.any()):
        raise ValueError(f"{path}: all {len(enough)} splats are fainter than --least-opacity (least_opacity) {least:g}")
    if not bool(enough.all()):
        told = f"{int((~enough).sum())} of {len(enough)} splats are fainter than an opacity of {least:g}"
        way_out = "they are left out; `torchjoint label` gives them the label of the nearest point"
        warnings.warn(f"{path}: {told}; {way_out}", stacklevel=4)
    return enough


def _read(path: Path, columns: int | str | None) -> CloudFile:
    """The cloud with its invalid points."""
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise ValueError(f"{path}: expected a file that ends in {', '.join(SUFFIXES)}")
    present(path, "a point cloud")
    if isinstance(columns, str):
        if suffix not in LETTERED:
            raise ValueError(f"{path}: expected a file that ends in {', '.join(LETTERED)}, for columns {columns!r}")
        xyz, rgb, n = ([columns.count(letter) for letter in letters] for letters in ("xyz", "rgb", "n"))
        if xyz != [1, 1, 1] or rgb not in ([0, 0, 0], [1, 1, 1]) or n not in ([0], [3]):
            raise ValueError(f"columns: expected x, y, z, and r, g, b or nnn if there are any, got {columns!r}")
    elif columns is not None and (suffix != ".bin" or columns < 3):
        raise ValueError(f"{path}: expected at least 3 columns, and a file that ends in .bin, got {columns} columns")
    if suffix in _READERS:
        return _READERS[suffix](path)
    if suffix == ".bin":
        if isinstance(columns, str):
            return cloud_of_letters(read_scan(path, len(columns), "keep").numpy(), columns)
        usual = 5 if path.name.lower().endswith(".pcd.bin") else 4
        return CloudFile(read_scan(path, columns or usual, "keep", plausible=columns is None)[:, :3])
    with damage_is(f"{path}: not a whole {suffix} cloud", OSError):
        if suffix == ".npz":
            return _from_archive(path)
        if suffix == ".npy":
            rows = read_array(path).numpy()
            return cloud_of_letters(rows, columns) if isinstance(columns, str) else cloud_of_rows(rows, str(path))
    return read_text_cloud(path, columns if isinstance(columns, str) else None)


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
    return best if steps[best] < LOWER_STEP * steps[rows.shape[1]] else None


def read_scan(path: Path, columns: int, invalid: Invalid = "refuse", *, plausible: bool = False) -> Tensor:
    """Reads a LiDAR scan, float32 rows x, y, z, ...; returns [N, columns]. `plausible`: else an error."""
    size = present(path, "a LiDAR scan").stat().st_size
    if size == 0 or size % (4 * columns):
        raise ValueError(f"{path}: expected rows of {columns} float32, {4 * columns} bytes each, got {size} bytes")
    if np.fromfile(path, "S4", 1)[0] == b"CCB2":
        raise ValueError(f"{path}: expected rows of float32, got a project of CloudCompare; save it as .ply there")
    rows = torch.from_numpy(np.fromfile(path, dtype="<f4").reshape(-1, columns))
    if plausible and (better := likelier_columns(rows)) is not None:
        told = f"{path}: expected rows of {columns} float32, but rows of {better} are more plausible: consecutive"
        number = f"--columns {better} or --columns {columns}, of nuScenes num_pts_feats"
        raise ValueError(f"{told} points are then near each other; give the number of columns ({number})")
    return rows[kept_points(rows[:, :3], str(path), invalid, "keep" if invalid == "keep" else "drop any")]


def _from_archive(path: Path) -> CloudFile:
    values = {name: one.astype(one.dtype.newbyteorder("="), copy=False) for name, one in read_archive(path).items()}
    if "points" not in values:
        raise ValueError(f"expected an array `points`, got {', '.join(values) or 'none'}")
    count = len(values["points"]) if values["points"].shape[1:] == (3,) else -1
    names = {"points": ("x", "y", "z"), "colors": ("r", "g", "b"), "normals": ("nx", "ny", "nz")}
    for name in names:
        if name in values and (values[name].shape != (count, 3) or values[name].dtype.kind in "US"):
            got = f"{values[name].dtype} {[*values[name].shape]}"
            raise ValueError(f"{name}: expected a row of three numbers for each point, got {got}")
    bounds.check_points(max(count, len(values.get("faces", ()))), path.stat().st_size)
    tell_not_read(set(values) - {*names, "faces"}, str(path))
    columns = {name: values[array][:, at] for array in names if array in values for at, name in enumerate(names[array])}
    cloud, faces = cloud_of(columns, str(path)), values.get("faces", np.empty(0))
    if not len(faces):
        return cloud
    if faces.shape[1:] != (3,) or faces.dtype.kind not in "iu" or not 0 <= faces.min() <= faces.max() < count:
        raise ValueError(f"faces: expected rows of three of the {count} points, got {faces.dtype} {[*faces.shape]}")
    return cloud._replace(faces=torch.from_numpy(faces.astype(np.int64)))
