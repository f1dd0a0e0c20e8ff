"""Triangle meshes with texture coordinates: boxes, surfaces of revolution and tubes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from torchjoint_lab.synthetic.furnished.arrays import Array

#: Corners of a face of the unit cube, (0,0) (1,0) (1,1) (0,1) in the two axes of the face.
_CORNERS = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=np.float64)
_TWO_TRIANGLES = np.array([[0, 1, 2], [0, 2, 3]])
#: Profile corners sharper than this (cosine of the angle) keep two normals; other corners are shaded smoothly.
_CREASE_COSINE = 0.7


@dataclass(frozen=True)
class Part:
    """Triangles of one material."""

    positions: Array  #: [T, 3, 3] corners, metres
    normals: Array  #: [T, 3, 3] unit normals at the corners, for shading only
    uv: Array  #: [T, 3, 2] texture coordinates along the surface, metres

    def moved(self, translation: Sequence[float] | Array = (0, 0, 0), yaw: float = 0.0, pitch: float = 0.0) -> Part:
        """Returns the part rotated by ``pitch`` about x, then ``yaw`` about z (radians), then translated (metres)."""
        rotation = rotation_z(yaw) @ rotation_x(pitch)
        return Part(self.positions @ rotation.T + np.asarray(translation), self.normals @ rotation.T, self.uv)


def rotation_x(angle: float) -> Array:
    """[3, 3] rotation about x by ``angle`` radians."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def rotation_z(angle: float) -> Array:
    """[3, 3] rotation about z by ``angle`` radians."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def box(size: Sequence[float], at: Sequence[float] = (0, 0, 0)) -> Part:
    """A box of ``size`` (x, y, z) metres; ``at`` is the center of its bottom; z = 0 if omitted.

    uv start at the lowest corner of each face.
    """
    positions, normals, uv = [], [], []
    extent = np.asarray(size, dtype=np.float64)
    low = np.array([*at, 0.0][:3]) - extent * [0.5, 0.5, 0.0]
    for axis in range(3):
        others = [a for a in range(3) if a != axis]
        for side in (0, 1):
            corners = np.zeros((4, 3))
            corners[:, others] = _CORNERS
            corners[:, axis] = side
            normal = np.zeros(3)
            normal[axis] = 2 * side - 1
            positions.append((low + corners * extent)[_TWO_TRIANGLES])
            normals.append(np.broadcast_to(normal, (2, 3, 3)))
            uv.append((_CORNERS * extent[others])[_TWO_TRIANGLES])
    return Part(np.concatenate(positions), np.concatenate(normals), np.concatenate(uv))


def lathe(profile: Sequence[tuple[float, float]], at: Sequence[float] = (0, 0, 0), segments: int = 28) -> Part:
    """The surface of revolution of a ``profile`` of (radius, height), metres, about the z axis through ``at``.

    The profile runs from the bottom outwards and up; for a hollow body it then runs down again inside.
    """
    line = np.asarray(profile, dtype=np.float64)
    step = np.diff(line, axis=0)
    length = np.maximum(np.linalg.norm(step, axis=1), 1e-9)
    along = np.concatenate([[0.0], np.cumsum(length)])
    flat = np.stack([step[:, 1], -step[:, 0]], axis=1) / length[:, None]
    start, end = flat.copy(), flat.copy()
    for i in range(1, len(flat)):
        if flat[i] @ flat[i - 1] > _CREASE_COSINE:
            start[i] = end[i - 1] = (flat[i] + flat[i - 1]) / np.linalg.norm(flat[i] + flat[i - 1])
    angle = np.linspace(0, 2 * np.pi, segments + 1)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    corner = [(0, 0), (0, 1), (1, 1), (1, 0)]  # (along the profile, along the circle)
    quads_p, quads_n, quads_uv = [], [], []
    for up, around in corner:
        turn = circle[around : segments + around]
        point, normal = (line[1:], end) if up else (line[:-1], start)
        quads_p.append(_revolve(point, turn))
        quads_n.append(_revolve(normal, turn))
        u = np.broadcast_to(angle[around : segments + around] * line[:, 0].max(), (len(step), segments))
        v = np.broadcast_to(along[up : len(step) + up, None], (len(step), segments))
        quads_uv.append(np.stack([u, v], axis=-1))
    part = [np.stack(q, axis=2)[:, :, _TWO_TRIANGLES] for q in (quads_p, quads_n, quads_uv)]
    positions, normals, uv = (p.reshape(-1, 3, p.shape[-1]) for p in part)
    edges = np.cross(positions[:, 1] - positions[:, 0], positions[:, 2] - positions[:, 0])
    solid = np.linalg.norm(edges, axis=1) > 1e-12  # quads that touch the axis have one degenerate triangle
    return Part((positions + np.asarray(at, dtype=np.float64))[solid], normals[solid], uv[solid])


def _revolve(radius_height: Array, circle: Array) -> Array:
    """Revolves [P, 2] of (r, z) along [S, 2] of (cos, sin); returns [P, S, 3]."""
    flat = radius_height[:, None, :1] * circle[None]
    height = np.broadcast_to(radius_height[:, None, 1:], (len(radius_height), len(circle), 1))
    return np.concatenate([flat, height], axis=2)


def cylinder(radius: float, height: float, at: Sequence[float] = (0, 0, 0), segments: int = 24) -> Part:
    """A closed upright cylinder; ``at`` is the center of its bottom. Metres."""
    return lathe([(0, 0), (radius, 0), (radius, height), (0, height)], at, segments)


def ball(radius: float, at: Sequence[float] = (0, 0, 0)) -> Part:
    """A sphere; ``at`` is its lowest point. Metres."""
    polar = np.linspace(-np.pi / 2, np.pi / 2, 15)
    return lathe([(radius * np.cos(a), radius * (1 + np.sin(a))) for a in polar], at)


def cup(radius: float, height: float, wall: float, flare: float = 1.0, rounded: bool = False) -> Part:
    """A hollow vessel, open at the top: a cup (straight), a bin (flared) or a bowl (``rounded``: an elliptic arc).

    Args:
        radius: outer radius at the rim, metres.
        height: outer height, metres.
        wall: thickness of wall and bottom, metres.
        flare: rim radius / foot radius; ignored if ``rounded``.
        rounded: makes a bowl; its foot radius is 0.35 of the rim radius.
    """
    outer, inner = cup_profiles(radius, height, wall, flare, rounded)
    return lathe([*outer, *inner])


def cup_profiles(
    radius: float, height: float, wall: float, flare: float, rounded: bool
) -> tuple[list[tuple[float, float]], list[tuple[float, float]]]:
    """(radius, z) of a cup's outside from the middle of its foot to the rim, and of its inside from the rim on."""
    if rounded:
        arc = np.linspace(np.arcsin(0.35), np.pi / 2, 9)
        bottom = 1 - np.cos(arc[0])
        outer = [(radius * np.sin(a), height * (1 - np.cos(a) - bottom) / (1 - bottom)) for a in arc]
    else:
        outer = [(radius / flare, 0.0), (radius, height)]
    inner = [(max(r - wall, 1e-3), max(z, wall)) for r, z in reversed(outer)]
    return [(0.0, 0.0), *outer], [*inner, (0.0, wall)]


def tube(path: Array, radius: float, segments: int = 8) -> Part:
    """A round tube along ``path`` [P, 3], open at its ends. Metres.

    A point at the place of the one before it is left out; at least two must remain.
    """
    path = path[np.append(True, np.linalg.norm(np.diff(path, axis=0), axis=1) > 1e-9)]
    tangent = np.gradient(path, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    helper = np.where(np.abs(tangent[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    side = np.cross(tangent, helper)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    up = np.cross(side, tangent)
    angle = np.linspace(0, 2 * np.pi, segments + 1)
    normal = side[:, None] * np.cos(angle)[None, :, None] + up[:, None] * np.sin(angle)[None, :, None]
    grid = path[:, None] + radius * normal
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    uv = np.stack(np.broadcast_arrays(angle[None] * radius, along[:, None]), axis=-1)

    def triangles(values: Array) -> Array:
        quad = np.stack([values[:-1, :-1], values[:-1, 1:], values[1:, 1:], values[1:, :-1]], axis=2)
        return quad[:, :, _TWO_TRIANGLES].reshape(-1, 3, values.shape[-1])

    return Part(triangles(grid), triangles(normal), triangles(uv))
