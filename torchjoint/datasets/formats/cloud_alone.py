"""Reads a point cloud alone, without images: .ply, .pcd, .npy, .npz, .xyz, .txt, .las, .laz, .e57, and KITTI's .bin.

The scene has no frames: segmenting it is plain 3D segmentation. :mod:`torchjoint.datasets.files.clouds` says what the
files hold.
"""

from __future__ import annotations

from pathlib import Path

from torchjoint.datasets.files.clouds import read_cloud_file
from torchjoint.datasets.recording import Options
from torchjoint.scene import Scene

WHAT = "a point cloud alone: .ply, .pcd, .npy, .npz, .xyz, .txt, .las, .laz, .e57, .bin"
SUFFIXES = (".ply", ".pcd", ".npy", ".npz", ".xyz", ".txt", ".las", ".laz", ".e57", ".bin")


def recognizes(path: Path) -> bool:
    """Returns whether `path` is a file that can hold a cloud. Formats of clouds with images are tried before."""
    return path.is_file() and path.suffix.lower() in SUFFIXES


def load(path: Path, options: Options) -> Scene:
    """Loads the cloud; see :func:`torchjoint.load_scene`."""
    cloud = read_cloud_file(path, invalid=options.invalid)
    points = cloud.points if cloud.points.is_floating_point() else cloud.points.double()
    return Scene(points, colors=cloud.colors, normals=cloud.normals, name=path.stem)
