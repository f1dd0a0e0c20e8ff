"""Reads S3DIS (Armeni et al., CVPR 2016), Stanford3dDataset_v1.2 (also _Aligned_Version): one room, without images.

Area_1/office_1/Annotations/CLASS_N.txt   the points of one thing: lines of x y z r g b; metres, colours 0-255
Area_1/office_1/office_1.txt              the same points without instances; not read

The points are those of Annotations/, file after file, sorted by name, as in PointNet's collect_indoor3d_data.py; the
instance of a point is the number of its file. No room was at hand: the layout is that of public readers.
"""

import io
import re
import warnings
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch

from torchjoint.datasets.recording import Options
from torchjoint.runtime.foreign_files import damage_is, has_folder, or_unreadable, read_file
from torchjoint.scene import Scene, Truth

#: Five files, as they are downloaded, have one flipped bit: bytes 0, 16 and 22 in place of a space, 0 and 6.
_REPAIRED = bytes(byte | 0x20 if byte in (0x00, 0x10, 0x16) else byte for byte in range(256))
_TEXT = "*.[tT][xX][tT]"
WHAT = "Annotations/ with CLASS_N.txt, such as chair_1.txt (a room of S3DIS)"


def recognizes(path: Path) -> bool:
    return has_folder(path) and bool(_things(path))


def load(path: Path, options: Options) -> Scene:
    things = _things(path)
    if left := sorted(file.name for file in (path / "Annotations").rglob(_TEXT) if file not in things):
        warnings.warn(f"{path}: {len(left)} files in Annotations are no CLASS_N.txt; not read: {left[0]}", stacklevel=3)
    parts = [_read_points(file) for file in things]
    rows = torch.from_numpy(np.concatenate(parts))
    instances = torch.cat([torch.full((len(part),), index) for index, part in enumerate(parts)])
    return Scene(rows[:, :3], colors=(rows[:, 3:] / 255).float(), name=path.name, truth=Truth(instances))


def scenes(path: Path) -> dict[str, Path]:
    """Returns the rooms of an area, or of all areas."""
    inside = "*" if any(recognizes(one.parent) for one in path.glob("*/Annotations")) else "Area_*/*"
    if not any(path.glob(f"{inside}/Annotations")):
        return {}
    rooms = [one for one in sorted(path.glob(inside)) if or_unreadable(recognizes, one)]
    return {one.name if inside == "*" else f"{one.parent.name}_{one.name}": one for one in rooms}


def _things(path: Path) -> list[Path]:
    return sorted(file for file in (path / "Annotations").glob(_TEXT) if re.fullmatch(r"[A-Za-z]+_[0-9]+", file.stem))


def _read_points(file: Path) -> npt.NDArray[np.float64]:
    text = read_file(file, "a point cloud").translate(_REPAIRED)
    with damage_is(f"{file}: expected lines of x y z r g b"):
        rows = np.loadtxt(io.BytesIO(text), comments=None, ndmin=2) if text.strip() else np.empty((0, 0))
    if rows.shape[1] != 6 or not np.isfinite(rows).all() or rows[:, 3:].min() < 0 or rows[:, 3:].max() > 255:
        raise ValueError(f"{file}: expected lines of x y z r g b, colours 0 to 255, got an array {list(rows.shape)}")
    return rows
