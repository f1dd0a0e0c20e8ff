"""Renders a world by ray casting: the light, labels and depth that a pinhole camera sees."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from torchjoint_lab.synthetic.furnished.arrays import Array
from torchjoint_lab.synthetic.furnished.rays import RayCaster
from torchjoint_lab.synthetic.furnished.world import Light, World

#: Offset of shadow rays from the surface, metres: less than the thinnest sheet (1 mm), more than float32 noise (1 um).
_OFFSET = 2e-4
#: Largest distance at which an object blocks ambient light, metres.
_AMBIENT_REACH = 0.5
#: Hits that are shaded at once: as many as fit into a processor's cache.
_CHUNK = 1 << 15
#: Linear light by sRGB byte.
_LINEAR = (np.arange(256) / 255.0).astype(np.float32) ** np.float32(2.2)


@dataclass(frozen=True)
class View:
    """An image without noise."""

    light: Array  #: [H, W, 3] linear RGB, unbounded
    labels: Array  #: [H, W] int64, the instance at each pixel's centre, -1 where the ray hits nothing
    depth: Array  #: [H, W] metres along z, 0 where the ray hits nothing
    facing: Array  #: [H, W] cosine between surface normal and ray
    absorbs: Array  #: [H, W] share of the surface that returns no depth to the sensor, 0 to 1


class Renderer:
    """Casts rays into one world.

    Args:
        world: the world to render.
        shadows: False: nothing blocks the light between lamps and surfaces.
    """

    def __init__(self, world: World, shadows: bool = True) -> None:
        self._world = world
        self._shadows = shadows
        self._rays = RayCaster(world.triangles)
        edges = world.triangles[:, 1:] - world.triangles[:, :1]
        cross = np.cross(edges[:, 0], edges[:, 1])
        self._face_normals = cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-20)
        tiles = [material.tile for material in world.materials]
        self._texels = _LINEAR[np.concatenate([tile.reshape(-1, 3) for tile in tiles])]
        self._tile_start = np.cumsum([0] + [tile.shape[0] * tile.shape[1] for tile in tiles])[:-1].astype(np.int32)
        self._tile_shape = np.array([tile.shape[:2] for tile in tiles], dtype=np.int32)
        self._tile_size = np.array([m.size for m in world.materials], dtype=np.float32)
        self._gloss = np.array([m.gloss for m in world.materials], dtype=np.float32)
        self._absorbs = np.array([m.absorbs for m in world.materials], dtype=np.float32)

    def view(self, camera_from_world: Array, intrinsics: Array, height: int, width: int) -> View:
        """Renders the view of a camera with pixel centres at integer coordinates.

        Rays go through pixel centres and half-way between them; a 3 x 3 tent filter combines them to a pixel's colour.
        Labels and depths come from the centres only.

        Args:
            camera_from_world: [4, 4] true pose.
            intrinsics: [3, 3], pixels.
            height: pixels.
            width: pixels.
        """
        rows = np.arange(-0.5, height, 0.5, dtype=np.float32)
        columns = np.arange(-0.5, width, 0.5, dtype=np.float32)
        focal, centre = intrinsics[[0, 1], [0, 1]], intrinsics[:2, 2]
        x = ((columns - centre[0]) / focal[0]).astype(np.float32)[None]
        y = ((rows - centre[1]) / focal[1]).astype(np.float32)[:, None]
        turn = camera_from_world[:3, :3].astype(np.float32)
        eye = (-camera_from_world[:3, :3].T @ camera_from_world[:3, 3]).astype(np.float32)
        # Written out, since a BLAS product may round differently with another number of threads.
        direction = np.stack([x * turn[0, i] + y * turn[1, i] + turn[2, i] for i in range(3)], axis=-1)
        size = direction.shape[:2]
        direction = direction.reshape(-1, 3)
        hit = self._rays.cast(np.concatenate([np.broadcast_to(eye, direction.shape), direction], axis=1))
        triangle, depth, barycentric = hit
        seen = np.flatnonzero(np.isfinite(depth))
        parity = (np.arange(size[0])[:, None] % 2 * 2 + np.arange(size[1])[None] % 2).reshape(-1)
        light = np.full((len(direction), 3), 0.02, dtype=np.float32)
        for start in range(0, len(seen), _CHUNK):
            i = seen[start : start + _CHUNK]
            light[i] = self._shade(eye, direction[i], depth[i], triangle[i], barycentric[i], parity[i])
        centre_of = (slice(1, None, 2), slice(1, None, 2))
        at = triangle.reshape(size)[centre_of]
        valid = np.isfinite(depth).reshape(size)[centre_of]
        at = np.where(valid, at, 0)
        ray = direction.reshape(*size, 3)[centre_of]
        normal = self._face_normals[at]
        facing = np.abs(_dot(normal, ray)) / np.sqrt(_dot(ray, ray))
        return View(
            light=_tent(light.reshape(*size, 3)),
            labels=np.where(valid, self._world.labels[at], -1),
            depth=np.where(valid, depth.reshape(size)[centre_of], np.float32(0)),
            facing=np.where(valid, facing, np.float32(0)),
            absorbs=np.where(valid, self._absorbs[self._world.material_ids[at]], np.float32(0)),
        )

    def _shade(
        self, eye: Array, direction: Array, depth: Array, triangle: Array, barycentric: Array, parity: Array
    ) -> Array:
        """Linear RGB [S, 3] of S hits.

        ``parity`` (0 ... 3) selects one of four points of each lamp: averaging neighbours then makes soft shadows.
        """
        corners = self._world.corners
        u, v = barycentric[:, :1], barycentric[:, 1:]
        first, second, third = np.take(corners, triangle, axis=0).swapaxes(0, 1)
        values = first * (1 - u - v) + second * u + third * v
        point = eye + direction * depth[:, None]
        flat = np.take(self._face_normals, triangle, axis=0)
        towards = -np.sign(_dot(flat, direction))[:, None]
        flat = flat * towards
        normal = values[:, :3] * np.sign(_dot(values[:, :3], flat))[:, None]
        normal /= np.maximum(np.sqrt(_dot(normal, normal)), 1e-6)[:, None]
        gaze = -direction / np.sqrt(_dot(direction, direction))[:, None]
        start = point + flat * _OFFSET
        material = self._world.material_ids[triangle]
        gloss = self._gloss[material]
        sky = np.float32(self._world.ambient) * (0.75 + 0.25 * normal[:, 2])
        if self._shadows:
            sky = sky * self._open_sky(start, flat, parity)
        diffuse = np.repeat(sky[:, None], 3, axis=1).astype(np.float32)
        shine = np.zeros_like(diffuse)
        for lamp in self._world.lights:
            strength, half = self._lamp(lamp, start, normal, flat, gaze, parity)
            power = lamp.power.astype(np.float32)
            diffuse += strength[:, None] * power
            shine += (0.6 * gloss * half * strength)[:, None] * power
        return np.asarray(self._albedo(material, values[:, 3:]) * diffuse + shine)

    def _lamp(
        self, lamp: Light, start: Array, normal: Array, flat: Array, gaze: Array, parity: Array
    ) -> tuple[Array, Array]:
        """Irradiance [S] from a lamp of power 1, and the specular lobe [S]."""
        corner = np.array([[-1, -1, 0], [1, 0.6, 0], [0.6, -1, 0], [-0.6, 1, 0]]) * lamp.radius * 0.8
        to_lamp = np.take((lamp.position + corner).astype(np.float32), parity, axis=0) - start
        squared = _dot(to_lamp, to_lamp)
        unit = to_lamp / np.sqrt(squared)[:, None]
        strength = np.maximum(_dot(normal, unit), 0) / (squared + np.float32(0.5))
        if self._shadows:
            lit = np.flatnonzero((strength > 0) & (_dot(flat, unit) > 0))
            free = np.zeros(len(start), dtype=np.float32)
            rays = np.concatenate([start[lit], to_lamp[lit]], axis=1)
            free[lit] = ~self._rays.blocked(rays)
            strength = strength * free
        bisector = unit + gaze
        cosine = _dot(bisector, normal) / np.maximum(np.sqrt(_dot(bisector, bisector)), 1e-6)
        lobe = np.maximum(cosine, 0)
        for _ in range(5):  # to the 32nd power
            lobe = lobe * lobe
        return strength, lobe

    def _open_sky(self, start: Array, flat: Array, parity: Array) -> Array:
        """[S] share of unblocked ambient light: one short ray per hit, so four rays per pixel."""
        four = np.array([[0.7, 0.4, 0.6], [-0.4, 0.7, 0.6], [-0.7, -0.4, 0.6], [0.4, -0.7, 0.6]], dtype=np.float32)
        ray = np.take(four, parity, axis=0) + flat
        side = _dot(ray, flat)
        ray = np.where((side > 0.05)[:, None], ray, flat) * np.float32(_AMBIENT_REACH)
        blocked = self._rays.blocked(np.concatenate([start, ray], axis=1))
        return np.asarray(1 - np.float32(0.6) * blocked)

    def _albedo(self, material: Array, uv: Array) -> Array:
        """[S, 3] linear reflectance: the nearest texel of the material's repeating texture."""
        shape = self._tile_shape[material]
        place = uv / self._tile_size[material]
        place -= np.floor(place)
        column = np.minimum((place[:, 0] * shape[:, 1]).astype(np.int32), shape[:, 1] - 1)
        row = np.minimum((place[:, 1] * shape[:, 0]).astype(np.int32), shape[:, 0] - 1)
        texel: Array = self._tile_start[material] + row * shape[:, 1] + column
        return np.asarray(np.take(self._texels, texel, axis=0))


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2])


def _tent(samples: Array) -> Array:
    """Filters half-pixel samples [2H + 1, 2W + 1, 3] to [H, W, 3], weights 1/4 1/2 1/4 along both axes."""
    rows = samples[1::2] * 0.5 + (samples[:-1:2] + samples[2::2]) * 0.25
    return np.asarray(rows[:, 1::2] * 0.5 + (rows[:, :-1:2] + rows[:, 2::2]) * 0.25)
