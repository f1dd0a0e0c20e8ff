"""How far a place is from the nearest surface."""

from __future__ import annotations

import numpy as np

from torchjoint_lab.synthetic.furnished.arrays import Array


def clearance(triangles: Array, place: Array) -> float:
    """Distance of a place [3] to the nearest of the triangles [T, 3, 3], metres."""
    corners = triangles.astype(np.float64) - place
    nearest = [_to_segment(corners[:, i], corners[:, (i + 1) % 3]) for i in range(3)]
    return float(np.sqrt(np.min([*nearest, _to_inside(corners)])))


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
