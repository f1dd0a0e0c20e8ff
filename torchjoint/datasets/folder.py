"""The plain folder, in the style of 7-Scenes (J. Shotton et al., CVPR 2013).

camera-intrinsics.txt          3x3, of the colour images
frame-NNNNNN.color.jpg|png     8-bit RGB
frame-NNNNNN.pose.txt          4x4, camera-to-world, OpenCV axes
frame-NNNNNN.depth.png         16-bit, millimetres, registered to colour; 0 and 65535 = unknown (optional)
frame-NNNNNN.labels.png        8- or 16-bit initial segmentation; 0 = none (optional)
cloud.ply                      the cloud (optional: fused from depth where absent)
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import overload

import torch
from torch import Tensor

from torchjoint.datasets.files import (
    read_cloud,
    read_depth,
    read_image,
    read_label_image,
    read_matrix,
    write_cloud,
)
from torchjoint.datasets.fusion import fuse_cloud
from torchjoint.scene import Frame, Scene, as_pose

WHAT = "camera-intrinsics.txt and frame-NNNNNN.color.jpg (or .png) with frame-NNNNNN.pose.txt"
_COLOR = (".color.jpg", ".color.jpeg", ".color.png")


def recognizes(path: Path) -> bool:
    """Whether the folder has colour frames of this format."""
    return path.is_dir() and bool(_color_files(path))


def load(path: Path, *, cloud: Path | None = None, voxel_size: float = 0.02, progress: bool = False) -> Scene:
    """Loads the folder; see :func:`torchjoint.load_scene`."""
    frames = FolderFrames(path)
    if cloud is None and (path / "cloud.ply").is_file():
        cloud = path / "cloud.ply"
    if cloud is not None and cloud.is_file():
        points, colors, normals = read_cloud(cloud)
    else:
        points, colors = fuse_cloud(frames, voxel_size, progress=progress)
        normals = None
        if cloud is not None:
            write_cloud(cloud, points, colors)
    return Scene(points, frames, colors, normals, name=path.name)


class FolderFrames(Sequence[Frame]):
    """The frames of a folder, each read when it is asked for.

    Raises:
        FileNotFoundError: a frame without a pose, or no intrinsics.
        ValueError: a pose that is not rigid, two images of one frame.
    """

    def __init__(self, path: Path) -> None:
        self._colors = _color_files(path)
        for file in self._colors:
            if not _beside(file, ".pose.txt").is_file():
                raise FileNotFoundError(f"{_beside(file, '.pose.txt')}: missing; every colour frame needs its pose")
        stems = [file.name.split(".")[0] for file in self._colors]
        if len(set(stems)) < len(stems):
            twice = next(stem for stem in stems if stems.count(stem) > 1)
            raise ValueError(f"{path}: frame {twice!r} has two colour images")
        # All poses at once: a bad one is to be found before hours of work, not after.
        self._poses = [_read_pose(_beside(file, ".pose.txt")) for file in self._colors]
        self._intrinsics = read_matrix(path / "camera-intrinsics.txt", (3, 3))

    def __len__(self) -> int:
        return len(self._colors)

    @overload
    def __getitem__(self, index: int) -> Frame: ...
    @overload
    def __getitem__(self, index: slice) -> list[Frame]: ...
    def __getitem__(self, index: int | slice) -> Frame | list[Frame]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        file = self._colors[index]
        depth, labels = _beside(file, ".depth.png"), _beside(file, ".labels.png")
        return Frame(
            read_image(file),
            self._intrinsics,
            invert_pose(self._poses[index]),
            depth=read_depth(depth) if depth.is_file() else None,
            labels=read_label_image(labels) - 1 if labels.is_file() else None,
            name=file.name.split(".")[0],
        )


def _read_pose(path: Path) -> Tensor:
    return as_pose(read_matrix(path, (4, 4)), str(path))


def invert_pose(pose: Tensor) -> Tensor:
    """The inverse of a rigid transform [4, 4]; camera-to-world becomes world-to-camera."""
    inverse = torch.eye(4, dtype=pose.dtype)
    inverse[:3, :3] = pose[:3, :3].T
    inverse[:3, 3] = -(pose[:3, :3].T @ pose[:3, 3])
    return inverse


def _color_files(path: Path) -> list[Path]:
    return sorted(file for file in path.iterdir() if file.name.startswith("frame-") and file.name.endswith(_COLOR))


def _beside(color_file: Path, suffix: str) -> Path:
    return color_file.with_name(color_file.name.split(".")[0] + suffix)
