"""Keeps fused clouds in the user's cache: fusing takes long, and the same recording is often loaded again."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

from torch import Tensor

from torchjoint.datasets.files.clouds import read_cloud_file
from torchjoint.datasets.files.ply import write_cloud
from torchjoint.datasets.files.readers import fingerprint
from torchjoint.datasets.fusion import fuse_cloud
from torchjoint.runtime.files import cache_folder
from torchjoint.runtime.foreign_files import has_file
from torchjoint.scene import Frame


def fuse_or_recall(
    path: Path, frames: Sequence[Frame], voxel_size: float, progress: bool | None
) -> tuple[Tensor, Tensor | None]:
    """Returns the cloud that is fused from the frames of a recording; from the cache, if it was fused before.

    Args:
        path: the recording. A cached cloud is not used if a file of the recording or the package's version changed.
        frames, voxel_size, progress: as of :func:`~torchjoint.datasets.fusion.fuse_cloud`.

    Returns:
        points [N, 3] metres and colours [N, 3] in [0, 1]; the same with and without the cache.
    """
    file = _file(path, voxel_size)
    if file is not None and has_file(file):
        try:
            points, colors = read_cloud_file(file)[:2]
            return points.float(), colors
        except ValueError:
            pass  # a damaged file is written anew
    points, colors = fuse_cloud(frames, voxel_size, progress=progress)
    if file is not None:
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            write_cloud(file, points, colors)
        except OSError:
            pass  # the disk is full, or there is no permission: the cloud is fused again next time
    return points, colors


def _file(path: Path, voxel_size: float) -> Path | None:
    folder = cache_folder()
    if folder is None:
        return None
    key = repr((fingerprint(path), float(voxel_size), version("torchjoint")))
    return folder / "clouds" / f"{hashlib.sha256(key.encode()).hexdigest()}.ply"
