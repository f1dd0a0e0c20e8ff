"""Casts rays into triangles, by Embree."""

from __future__ import annotations

import numpy as np

from torchjoint.runtime.extras import needed_for
from torchjoint.synthetic.arrays import Array


class RayCaster:
    """Casts rays into one set of triangles.

    Args:
        triangles: [T, 3, 3] float32, metres.

    Raises:
        ModuleNotFoundError: embreex is not installed.
    """

    def __init__(self, triangles: Array) -> None:
        with needed_for("tj.synthetic", "embreex", "embreex"):
            from embreex.mesh_construction import TriangleMesh
            from embreex.rtcore_scene import EmbreeScene

        self._triangles = np.ascontiguousarray(triangles, dtype=np.float32)
        self._scene = EmbreeScene(robust=True)  # no ray slips through between two triangles
        TriangleMesh(self._scene, self._triangles)

    def cast(self, rays: Array) -> tuple[Array, Array, Array]:
        """The first hit of each ray.

        Args:
            rays: [R, 6] float32, origin and direction; the direction's length is the unit of distances.

        Returns:
            triangle [R] int64, 0 where nothing is hit; distance [R] float32, inf where nothing is hit; and the hit's
            barycentric coordinates [R, 2] towards the triangle's second and third corner.
        """
        hit = self._scene.run(*_halves(rays), output=1)
        seen = hit["primID"] >= 0
        triangle = np.where(seen, hit["primID"], 0).astype(np.int64)
        return triangle, np.where(seen, hit["tfar"], np.float32(np.inf)), np.stack([hit["u"], hit["v"]], axis=1)

    def blocked(self, rays: Array) -> Array:
        """[R] bool: something is between the origin and origin + direction."""
        origins, directions = _halves(rays)
        reach = np.ones(len(origins), dtype=np.float32)
        return np.asarray(self._scene.run(origins, directions, dists=reach, query="OCCLUDED") >= 0)

    def clearance(self, place: Array) -> float:
        """Distance of a place [3] to the nearest triangle, metres."""
        corners = self._triangles.astype(np.float64) - place
        nearest = [_to_segment(corners[:, i], corners[:, (i + 1) % 3]) for i in range(3)]
        return float(np.sqrt(np.min([*nearest, _to_inside(corners)])))


def _halves(rays: Array) -> tuple[Array, Array]:
    return np.ascontiguousarray(rays[:, :3], np.float32), np.ascontiguousarray(rays[:, 3:], np.float32)


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1] + a[:, 2] * b[:, 2])


def _to_segment(start: Array, end: Array) -> Array:
    """[T] squared distance of the origin to segments."""
    along = end - start
    share = np.clip(-_dot(start, along) / np.maximum(_dot(along, along), 1e-30), 0, 1)
    nearest = start + along * share[:, None]
    return _dot(nearest, nearest)


def _to_inside(corners: Array) -> Array:
    """[T] squared distance of the origin to the planes of triangles; inf where its foot lies outside the triangle."""
    a, b, c = corners.swapaxes(0, 1)
    normal = np.cross(b - a, c - a)
    squared = _dot(normal, normal)
    sides = [_dot(np.cross(q - p, -p), normal) for p, q in ((a, b), (b, c), (c, a))]
    inside = (np.min(sides, axis=0) >= 0) & (squared > 1e-30)
    return np.where(inside, _dot(a, normal) ** 2 / np.maximum(squared, 1e-30), np.inf)
