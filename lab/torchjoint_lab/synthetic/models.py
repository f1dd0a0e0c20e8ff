"""Reading the file of one model: triangles, textures and colours, z-up and in metres."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from torchjoint.runtime.messages import needed_for
from torchjoint_lab.synthetic.furnished.arrays import Array
from torchjoint_lab.synthetic.furnished.materials import Material
from torchjoint_lab.synthetic.furnished.mesh import Part

#: Models with more triangles are left out.
_MOST_TRIANGLES = 60_000
#: Textures are reduced to so many texels a side.
_SIDE = 256


def load_parts(
    path: Path, size: tuple[float, float, float] | None, turn: Array | None
) -> tuple[tuple[Part, Material], ...] | None:
    """The parts of an OBJ or GLB file, one for each material.

    Args:
        path: of the file; y-up.
        size: (width, depth, height) metres that it is scaled to, by one factor; None leaves it as it is.
        turn: [3, 3] rotation that goes before all else, or None.

    Returns:
        Parts whose foot is at z = 0, their middle at the origin; None for a file without triangles, or with too many.
    """
    with needed_for("reading models of things", "Open3D", "torchjoint[open3d]"):
        import open3d as o3d

    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        model = o3d.io.read_triangle_model(str(path))
    meshes = [(info.mesh, model.materials[info.material_idx]) for info in model.meshes if len(info.mesh.triangles)]
    if not meshes or sum(len(mesh.triangles) for mesh, _ in meshes) > _MOST_TRIANGLES:
        return None
    read = [(_part(mesh, turn), _material(material)) for mesh, material in meshes]
    corners = np.concatenate([part.positions.reshape(-1, 3) for part, _ in read])
    low, extent = corners.min(axis=0), np.ptp(corners, axis=0)
    if not np.isfinite(corners).all() or extent.max() <= 0:
        return None
    scale = 1.0 if size is None else float(max(size) / extent.max())
    foot = low + extent * [0.5, 0.5, 0.0]
    return tuple((Part((part.positions - foot) * scale, part.normals, part.uv), material) for part, material in read)


def _part(mesh, turn: Array | None) -> Part:  # type: ignore[no-untyped-def]
    """Triangles of an Open3D mesh, x right, z up, front towards -y."""
    faces = np.asarray(mesh.triangles)
    mesh.compute_vertex_normals()
    basis = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    rotation = basis if turn is None else np.stack([sum(basis[i, k] * turn[k] for k in range(3)) for i in range(3)])

    def moved(values: Array) -> Array:
        return np.stack([sum(values[:, k] * rotation[i, k] for k in range(3)) for i in range(3)], axis=1)[faces]

    positions, normals = moved(np.asarray(mesh.vertices)), moved(np.asarray(mesh.vertex_normals))
    uv = np.asarray(mesh.triangle_uvs).reshape(-1, 3, 2) if mesh.has_triangle_uvs() else positions[..., :2] * 0.0
    return Part(positions, normals, np.nan_to_num(uv))


def _material(record) -> Material:  # type: ignore[no-untyped-def]
    """The texture of an Open3D material as a tile of one unit of uv, or its colour."""
    import cv2

    color = np.clip(np.asarray(record.base_color, dtype=np.float64)[:3], 0.02, 0.97)
    image = None if record.albedo_img is None else np.asarray(record.albedo_img)
    if image is None or image.size == 0:
        return Material(np.round(color * 255).astype(np.uint8)[None, None], (1.0, 1.0), 0.15)
    image = image if image.ndim == 3 else image[..., None]
    image = np.repeat(image, 3, axis=2) if image.shape[2] < 3 else image[..., :3]
    if image.dtype != np.uint8:
        image = np.clip(image / (65535 if image.dtype == np.uint16 else 1) * 255, 0, 255).astype(np.uint8)
    h, w = (min(side, _SIDE) for side in image.shape[:2])
    small = cv2.resize(np.ascontiguousarray(image), (w, h), interpolation=cv2.INTER_AREA)
    return Material(np.ascontiguousarray(small[::-1]), (1.0, 1.0), 0.15)
