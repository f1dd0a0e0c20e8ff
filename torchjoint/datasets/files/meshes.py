"""Meshes: .obj, .glb, .gltf, .off and .stl files by trimesh, and points on meshes of large triangles."""

from __future__ import annotations

import io
import warnings
from pathlib import Path

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor
from torch.nn.functional import normalize

from torchjoint.datasets.files.columns import CloudFile
from torchjoint.datasets.files.gltf import Parts, bound_textures, check_gltf
from torchjoint.runtime.extras import needed_for
from torchjoint.runtime.foreign_files import read_file

SUFFIXES = (".obj", ".glb", ".gltf", ".off", ".stl")
#: A triangle is large if its longest edge is longer than this share of the mesh's diagonal.
LARGE = 0.02
#: Points are drawn if large triangles have more than this share of the area; this is the number of points.
MUCH, SAMPLES = 0.1, 200_000
#: Triangles agree on their outer side if this share of their edges runs the other way in a neighbouring triangle.
AGREED = 0.9


def read_mesh_file(path: Path) -> CloudFile:
    """Reads all meshes of a file as one, in the file's world frame.

    Colours are those of vertices, faces or textures, if there are any. Normals are not read: in many files they are
    those of a smooth picture. Equal vertices of an .stl are one vertex.

    Raises:
        ModuleNotFoundError: trimesh is not installed.
        FileNotFoundError, ValueError: the message names the file and its error.
    """
    with needed_for(f"{path.suffix} files", "trimesh", "torchjoint[mesh]"):
        import trimesh
    data, suffix, parts = read_file(path, "a mesh"), path.suffix.lower(), Parts(path)
    bound_textures()
    try:
        if suffix in (".gltf", ".glb"):
            check_gltf(data, parts, str(path))
        mesh = trimesh.load_scene(io.BytesIO(data), file_type=suffix[1:], resolver=parts, process=False).to_mesh()  # type: ignore[arg-type]  # it only gets
        if parts.error is not None:
            raise parts.error
        if suffix == ".stl":
            mesh.merge_vertices()
        points, faces = np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int64)
        kind = mesh.visual.kind
        colors = mesh.visual.vertex_colors if kind in ("vertex", "face") else None
        colors = mesh.visual.to_color().vertex_colors if kind == "texture" else colors
    except MemoryError:
        raise
    except Exception as error:  # trimesh raises errors of many types for damaged files
        raise ValueError(f"{path}: not a whole {path.suffix} mesh: {error!r}"[:300]) from error
    if not len(points) or points.shape[1:] != (3,):
        raise ValueError(f"{path}: expected a mesh with vertices, got none")
    if len(faces) and not 0 <= faces.min() <= faces.max() < len(points):
        raise ValueError(f"{path}: expected faces of {len(points)} vertices, got {faces.min()} to {faces.max()}")
    rgb = None
    if colors is not None and len(colors) == len(points):
        rgb = torch.from_numpy(np.asarray(colors)[:, :3].astype(np.float32) / 255)
    return CloudFile(torch.from_numpy(points), rgb, None, torch.from_numpy(faces) if len(faces) else None)


def has_large_triangles(points: Tensor, faces: Tensor) -> bool:
    """Whether the vertices of a mesh say little about its surface, as in models that are drawn and not scanned."""
    corners = points[faces].double()
    edges = (corners - corners.roll(1, 1)).norm(dim=2).amax(1)
    area = _areas(corners)
    diagonal = (points.double().amax(0) - points.double().amin(0)).norm()
    return bool(area[edges > LARGE * diagonal].sum() > MUCH * area.sum())


def vertex_normals(points: Tensor, faces: Tensor) -> Tensor | None:
    """The mean normals of the triangles around each vertex, weighted by area; a vertex of none has the nearest one's.

    Args:
        points: [V, 3] vertices.
        faces: [F, 3] int64, counter-clockwise from outside.

    Returns:
        [V, 3] float32 of unit length; None if the triangles do not agree on an outer side, as those of loose surfaces.
    """
    a, b = torch.stack([faces, faces.roll(-1, 1)]).flatten(1)
    if float(torch.isin(b * len(points) + a, a * len(points) + b).float().mean()) < AGREED:
        return None
    first, second, third = points[faces].double().unbind(1)
    areas = torch.linalg.cross(second - first, third - first, dim=1).repeat_interleave(3, 0)
    normals = torch.zeros(len(points), 3, dtype=torch.float64).index_add_(0, faces.flatten(), areas)
    has = normals.any(1)
    if not bool(has.any()):
        return None
    if not bool(has.all()):
        normals[~has] = normals[has][cKDTree(points[has].numpy()).query(points[~has].numpy())[1]]
    return normalize(normals, dim=1, eps=0).float()


def points_on(points: Tensor, faces: Tensor, colors: Tensor | None, name: str) -> tuple[Tensor, Tensor | None]:
    """Draws points on the triangles, evenly by area; the same for equal meshes.

    Args:
        points: [V, 3] vertices.
        faces: [F, 3] int64.
        colors: [V, 3], or None; they are interpolated.
        name: begins the warning.

    Returns:
        points [SAMPLES, 3] float64, and their colours.
    """
    warnings.warn(
        f"{name}: the triangles are large, so {SAMPLES} points are drawn on them; `torchjoint label` labels the mesh",
        stacklevel=3,
    )
    random = torch.Generator().manual_seed(0)
    total = _areas(points[faces].double()).cumsum(0)
    drawn = torch.rand(SAMPLES, generator=random, dtype=torch.float64) * total[-1]
    face = torch.searchsorted(total, drawn, right=True).clamp(max=len(faces) - 1)
    u, v = torch.rand(2, SAMPLES, 1, generator=random, dtype=torch.float64)
    u, v = torch.where(u + v > 1, 1 - u, u), torch.where(u + v > 1, 1 - v, v)  # the other half of the parallelogram

    def between(values: Tensor) -> Tensor:
        a, b, c = values[faces[face]].double().unbind(1)
        return a + u * (b - a) + v * (c - a)

    return between(points), None if colors is None else between(colors).float()


def _areas(corners: Tensor) -> Tensor:
    a, b, c = corners.unbind(1)
    return torch.linalg.cross(b - a, c - a, dim=1).norm(dim=1) / 2
