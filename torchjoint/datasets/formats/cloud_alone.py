"""Reads a point cloud or a mesh alone, without images.

The scene has no frames: segmenting it is plain 3D segmentation. The points of a mesh are its vertices, with
the normals of its triangles; where these are large, points are drawn on them. :mod:`torchjoint.datasets.files.clouds`
says what the files hold.
"""

import warnings
from pathlib import Path

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor
from torch.nn.functional import normalize

from torchjoint.datasets.files.clouds import SUFFIXES, read_cloud_file, up_of
from torchjoint.datasets.recording import Options
from torchjoint.runtime.foreign_files import has_file
from torchjoint.scene import Scene

WHAT = f"a point cloud or a mesh alone: {', '.join(SUFFIXES)}"
#: A triangle is large if its longest edge is longer than this share of the mesh's diagonal.
LARGE = 0.02
#: Points are drawn if large triangles have more than this share of the area; this is the number of points.
LARGE_SHARE, SAMPLES = 0.1, 200_000
#: Triangles agree on their outer side if this share of their edges runs the other way in a neighbouring triangle.
AGREED = 0.9


def recognizes(path: Path) -> bool:
    return has_file(path) and path.suffix.lower() in SUFFIXES


def load(path: Path, options: Options) -> Scene:
    cloud = read_cloud_file(path, invalid=options.invalid, least_opacity=options.least_opacity)
    points, colors, normals, faces = cloud.points, cloud.colors, cloud.normals, cloud.faces
    if faces is not None and has_large_triangles(points, faces):
        (points, colors), normals = points_on(points, faces, colors, str(path)), None
    elif normals is None and faces is not None:
        normals = agreed_normals(points, faces)
    return Scene(points, colors=colors, normals=normals, name=path.stem, up=up_of(path))


def has_large_triangles(points: Tensor, faces: Tensor) -> bool:
    """Whether the vertices of a mesh say little about its surface, as in models that are drawn and not scanned."""
    corners = points[faces].double()
    edges = (corners - corners.roll(1, 1)).norm(dim=2).amax(1)
    area = _crosses(corners).norm(dim=1)
    diagonal = (points.double().amax(0) - points.double().amin(0)).norm()
    return bool(area[edges > LARGE * diagonal].sum() > LARGE_SHARE * area.sum())


def agreed_normals(points: Tensor, faces: Tensor) -> Tensor | None:
    """The mean normals of the triangles around each vertex, weighted by area; a vertex of none has the nearest one's.

    Args:
        points: [V, 3] vertices.
        faces: [F, 3] int64, counter-clockwise from outside.

    Returns:
        [V, 3] float32 of unit length; None if the triangles do not agree on an outer side, as loose or two-sided ones.
    """
    # At the seams of a texture, one vertex stands there several times: the first counts. Copies have its normal.
    rows = np.ascontiguousarray(points.double().numpy() + 0.0).view("V24").ravel()  # -0 becomes 0
    _, first, place = np.unique(rows, return_index=True, return_inverse=True)
    faces = torch.from_numpy(first[place])[faces]
    a, b = torch.stack([faces, faces.roll(-1, 1)]).flatten(1)
    there, back = a * len(points) + b, b * len(points) + a
    # Of triangles with two sides each edge runs both ways, and each way twice.
    if min(float(torch.isin(back, there).float().mean()), len(there.unique()) / len(there)) < AGREED:
        return None
    areas = _crosses(points[faces].double()).repeat_interleave(3, 0)
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
        points [SAMPLES, 3] float64 and the vertices of no triangle, and their colours.
    """
    told = f"{name}: the triangles are large, so {SAMPLES} points are drawn on them"
    warnings.warn(f"{told}; `torchjoint label` labels the mesh", stacklevel=3)
    random = torch.Generator().manual_seed(0)
    total = _crosses(points[faces].double()).norm(dim=1).cumsum(0)
    drawn = torch.rand(SAMPLES, generator=random, dtype=torch.float64) * total[-1]
    face = torch.searchsorted(total, drawn, right=True).clamp(max=len(faces) - 1)
    u, v = torch.rand(2, SAMPLES, 1, generator=random, dtype=torch.float64)
    u, v = torch.where(u + v > 1, 1 - u, u), torch.where(u + v > 1, 1 - v, v)  # the other half of the parallelogram

    def between(values: Tensor) -> Tensor:
        a, b, c = values[faces[face]].double().unbind(1)
        return a + u * (b - a) + v * (c - a)

    loose = torch.ones(len(points), dtype=torch.bool)
    loose[faces] = False  # points beside the meshes
    colors = None if colors is None else torch.cat([between(colors).float(), colors[loose]])
    return torch.cat([between(points), points[loose].double()]), colors


def _crosses(corners: Tensor) -> Tensor:
    """The normals of triangles [F, 3, 3], [F, 3]; their lengths are twice the areas."""
    a, b, c = corners.unbind(1)
    return torch.linalg.cross(b - a, c - a, dim=1)
