"""More solids than `furnished.mesh` has: rounded boxes, blobs, slabs, rings; and how to turn them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from torchjoint_lab.synthetic.furnished.arrays import Array, Rng
from torchjoint_lab.synthetic.furnished.mesh import Part, lathe, tube

_TWO = np.array([[0, 1, 2], [0, 2, 3]])


def turned(part: Part, rotation: Array, offset: Sequence[float] | Array = (0, 0, 0)) -> Part:
    """The part turned by a [3, 3] rotation, then translated (metres)."""
    return Part(part.positions @ rotation.T + np.asarray(offset), part.normals @ rotation.T, part.uv)


def euler(yaw: float = 0.0, pitch: float = 0.0, roll: float = 0.0) -> Array:
    """[3, 3] rotation: ``roll`` about y, then ``pitch`` about x, then ``yaw`` about z, radians."""
    c, s = np.cos([yaw, pitch, roll]), np.sin([yaw, pitch, roll])
    z = np.array([[c[0], -s[0], 0], [s[0], c[0], 0], [0, 0, 1]])
    x = np.array([[1, 0, 0], [0, c[1], -s[1]], [0, s[1], c[1]]])
    y = np.array([[c[2], 0, s[2]], [0, 1, 0], [-s[2], 0, c[2]]])
    return np.asarray(z @ x @ y)


def random_rotation(rng: Rng) -> Array:
    """[3, 3] rotation, each as likely as any other."""
    basis, triangle = np.linalg.qr(rng.standard_normal((3, 3)))
    basis = basis * np.sign(np.diag(triangle))
    return np.asarray(basis if np.linalg.det(basis) > 0 else basis * [1, 1, -1])


def sheet_of(points: Array, normals: Array, uv: Array) -> Part:
    """The triangles of a grid of points [A, B, 3] with normals [A, B, 3] and uv [A, B, 2]."""

    def triangles(values: Array) -> Array:
        quad = np.stack([values[:-1, :-1], values[1:, :-1], values[1:, 1:], values[:-1, 1:]], axis=2)
        return quad[:, :, _TWO].reshape(-1, 3, values.shape[-1])

    return Part(triangles(points), triangles(normals), triangles(uv))


def rounded_box(size: Sequence[float] | Array, radius: float, at: Sequence[float] | Array = (0, 0, 0)) -> Part:
    """A box of ``size`` metres whose edges are rounded by ``radius``; ``at`` is the middle of its bottom."""
    half = np.asarray(size, dtype=np.float64) / 2
    radius = min(radius, 0.98 * half.min())
    faces = []
    for axis in range(3):
        a, b = (k for k in range(3) if k != axis)
        bend = np.tan(np.linspace(-np.pi / 4, 0, 4)) * radius
        first, second = (np.concatenate([-half[k] + radius + bend, half[k] - radius - bend[::-1]]) for k in (a, b))
        for side in (-1, 1):
            grid = np.zeros((len(first), len(second), 3))
            grid[..., a], grid[..., b], grid[..., axis] = first[:, None], second[None], side * half[axis]
            core = np.clip(grid, radius - half, half - radius)
            normal = (grid - core) / np.linalg.norm(grid - core, axis=-1, keepdims=True)
            uv = np.stack([grid[..., a] + half[a], grid[..., b] + half[b]], axis=-1)
            faces.append(sheet_of(core + radius * normal + np.asarray(at) + [0, 0, half[2]], normal, uv))
    return joined(faces)


def blob(
    rng: Rng,
    size: Sequence[float] | Array,
    roughness: float = 0.1,
    square: float = 1.0,
    at: Sequence[float] | Array = (0, 0, 0),
) -> Part:
    """A lump of ``size`` (x, y, z) metres; ``at`` is the middle of its bottom.

    Args:
        rng: draws its bumps.
        size: extent before it is roughened.
        roughness: height of its bumps as a share of its radius.
        square: 1 an ellipsoid, towards 0 a box (the exponent of a superellipsoid).
        at: metres.
    """
    polar, turn = np.meshgrid(np.linspace(-np.pi / 2, np.pi / 2, 17), np.linspace(0, 2 * np.pi, 29), indexing="ij")

    def power(value: Array) -> Array:
        return np.asarray(np.sign(value) * np.abs(value) ** square)

    unit = np.stack(
        [power(np.cos(polar)) * power(np.cos(turn)), power(np.cos(polar)) * power(np.sin(turn)), power(np.sin(polar))],
        axis=-1,
    )
    bump = np.zeros(polar.shape)
    for _ in range(5):
        wave = rng.normal(0, 2.5, 3)
        phase = unit[..., 0] * wave[0] + unit[..., 1] * wave[1] + unit[..., 2] * wave[2]
        bump += np.sin(phase + rng.uniform(0, 6.3)) / 2.2
    points = unit * (1 + roughness * bump[..., None]) * np.asarray(size) / 2
    points[:, -1] = points[:, 0]
    normals = _grid_normals(points)
    uv = np.stack([turn * size[0] / 2, (polar + np.pi / 2) * size[2] / 2], axis=-1)
    return sheet_of(points + np.asarray(at) + [0, 0, -points[..., 2].min()], normals, uv)


def _grid_normals(points: Array) -> Array:
    """Outward unit normals of a closed grid [polar, turn, 3]; the two ends of ``turn`` are the same points."""
    along = np.gradient(points, axis=0)
    wrapped = np.concatenate([points[:, -2:-1], points, points[:, 1:2]], axis=1)
    around = wrapped[:, 2:] - wrapped[:, :-2]
    normal = np.cross(around, along)
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    radial = points / np.maximum(np.linalg.norm(points, axis=-1, keepdims=True), 1e-9)
    return np.where(length > 1e-12, normal / np.maximum(length, 1e-12), radial)


def slab(outline: Array, thickness: float) -> Part:
    """A plate with a star-shaped ``outline`` [P, 2] metres (counter-clockwise about its mean), its foot at z = 0."""
    middle = outline.mean(axis=0)
    following = np.roll(outline, -1, axis=0)
    fan = np.stack([np.broadcast_to(middle, outline.shape), outline, following], axis=1)
    caps, normals = [], []
    for z, up in ((0.0, -1.0), (thickness, 1.0)):
        corners = np.concatenate([fan, np.full((*fan.shape[:2], 1), z)], axis=2)
        caps.append(corners if up > 0 else corners[:, ::-1])
        normals.append(np.broadcast_to([0.0, 0.0, up], corners.shape))
    step = following - outline
    out = np.stack([step[:, 1], -step[:, 0], 0 * step[:, 0]], axis=1)
    out /= np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-9)
    low, high = (np.concatenate([ring, np.full((len(ring), 1), 0.0)], axis=1) for ring in (outline, following))
    lift = np.array([0, 0, thickness])
    quads = np.stack([low, high, high + lift, low + lift], axis=1)[:, _TWO].reshape(-1, 3, 3)
    positions = np.concatenate([*caps, quads])
    shading = np.concatenate([*normals, np.repeat(out[:, None, None], 2, axis=1).repeat(3, axis=2).reshape(-1, 3, 3)])
    flat = positions - positions.reshape(-1, 3).min(axis=0)
    uv = np.stack([flat[..., 0], flat[..., 1] + flat[..., 2]], axis=-1)
    return Part(positions, shading, uv)


def ring(radius: float, thickness: float, at: Sequence[float] | Array = (0, 0, 0), part: float = 1.0) -> Part:
    """A lying ring (or the first ``part`` of one) of ``radius`` and tube ``thickness`` (radii, metres) about ``at``."""
    angle = np.linspace(0, 2 * np.pi * part, max(int(28 * part), 6))
    path = np.stack([radius * np.cos(angle), radius * np.sin(angle), 0 * angle], axis=1)
    return tube(path + np.asarray(at), thickness)


def rod(start: Sequence[float] | Array, end: Sequence[float] | Array, radius: float, tip: float | None = None) -> Part:
    """A closed round rod from ``start`` to ``end``, its radius going over to ``tip``; metres."""
    a, b = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    length = float(np.linalg.norm(b - a))
    z = (b - a) / max(length, 1e-9)
    x = np.cross([0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [1.0, 0.0, 0.0], z)
    x /= np.linalg.norm(x)
    profile = [(0.0, 0.0), (radius, 0.0), (radius if tip is None else tip, length), (0.0, length)]
    return turned(lathe(profile, segments=14), np.stack([x, np.cross(z, x), z], axis=1), a)


def joined(parts: Sequence[Part]) -> Part:
    """All triangles of several parts as one."""
    return Part(
        np.concatenate([p.positions for p in parts]),
        np.concatenate([p.normals for p in parts]),
        np.concatenate([p.uv for p in parts]),
    )


def rotation_about(vector: Array) -> Array:
    """[3, 3] rotation by a rotation vector [3], radians."""
    angle = float(np.linalg.norm(vector))
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    squared = np.array([[x * x - 1, x * y, x * z], [x * y, y * y - 1, y * z], [x * z, y * z, z * z - 1]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * squared)


def rotated(points: Array, rotation: Array) -> Array:
    """[..., 3] points turned by [3, 3]. Written out: a BLAS product might round by the number of its threads."""
    x, y, z = points[..., 0], points[..., 1], points[..., 2]
    return np.stack([rotation[i, 0] * x + rotation[i, 1] * y + rotation[i, 2] * z for i in range(3)], axis=-1)
