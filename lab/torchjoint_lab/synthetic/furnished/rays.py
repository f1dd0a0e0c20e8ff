"""Casts rays into triangles, by Embree."""

from __future__ import annotations

import numpy as np

from torchjoint.runtime.messages import needed_for
from torchjoint_lab.synthetic.furnished.arrays import Array


class RayCaster:
    """Casts rays into one set of triangles.

    Args:
        triangles: [T, 3, 3] float32, metres.

    Raises:
        ModuleNotFoundError: embreex is not installed.
    """

    def __init__(self, triangles: Array) -> None:
        with needed_for("torchjoint_lab.synthetic", "embreex", "embreex"):
            from embreex.mesh_construction import TriangleMesh
            from embreex.rtcore_scene import EmbreeScene

        self._scene = EmbreeScene(robust=True)  # no ray slips through between two triangles
        TriangleMesh(self._scene, np.ascontiguousarray(triangles, dtype=np.float32))

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


def _halves(rays: Array) -> tuple[Array, Array]:
    return np.ascontiguousarray(rays[:, :3], np.float32), np.ascontiguousarray(rays[:, 3:], np.float32)
