"""Reads a point cloud or a mesh alone, without images.

The scene has no frames: segmenting it is plain 3D segmentation. The points of a mesh are its vertices, with
the normals of its triangles; where these are large, points are drawn on them. :mod:`torchjoint.datasets.files.clouds`
says what the files hold.
"""

from __future__ import annotations

from pathlib import Path

from torchjoint.datasets.files import meshes
from torchjoint.datasets.files.clouds import SUFFIXES, read_cloud_file
from torchjoint.datasets.recording import Options
from torchjoint.runtime.foreign_files import has_file
from torchjoint.scene import Scene

WHAT = f"a point cloud or a mesh alone: {', '.join(SUFFIXES)}"


def recognizes(path: Path) -> bool:
    return has_file(path) and path.suffix.lower() in SUFFIXES


def load(path: Path, options: Options) -> Scene:
    cloud = read_cloud_file(path, invalid=options.invalid, least_opacity=options.least_opacity)
    points = cloud.points if cloud.points.is_floating_point() else cloud.points.double()
    if cloud.faces is not None and meshes.has_large_triangles(points, cloud.faces):
        points, colors = meshes.points_on(points, cloud.faces, cloud.colors, str(path))
        return Scene(points, colors=colors, name=path.stem)
    normals = cloud.normals
    if normals is None and cloud.faces is not None:
        normals = meshes.vertex_normals(points, cloud.faces)
    return Scene(points, colors=cloud.colors, normals=normals, name=path.stem)
