"""A cheaper renderer: light is computed at the pixels' centres, texture and edges at their corners as well."""

from __future__ import annotations

import numpy as np

from torchjoint_lab.synthetic.clearance import clearance
from torchjoint_lab.synthetic.furnished.arrays import Array
from torchjoint_lab.synthetic.furnished.render import Renderer, View
from torchjoint_lab.synthetic.furnished.world import World

_OFFSET = 2e-4


class QuickRenderer(Renderer):
    """A :class:`~torchjoint_lab.synthetic.furnished.render.Renderer` at about a third of the cost.

    Two rays for each pixel, not four, and shadow rays for every second one of them: a corner gets the light of a
    neighbouring centre on the same instance, and a colour of its own.

    Args:
        world: what to look at.
        sky: light of what no ray hits, linear.
    """

    def __init__(self, world: World, sky: float = 0.02) -> None:
        super().__init__(world)
        self._sky = np.array([0.92, 0.97, 1.0], dtype=np.float32) * np.float32(sky)

    def cast(self, rays: Array) -> tuple[Array, Array, Array, Array]:
        """What [R, 6] rays (origin, direction) hit: instances [R] (-1 nothing), distances, cosines, absorption."""
        triangle, distance, _ = self._rays.cast(rays)
        seen = np.isfinite(distance)
        normal = np.take(self._face_normals, triangle, axis=0)
        ray = rays[:, 3:]
        facing = np.abs(_dot(normal, ray)) / np.sqrt(_dot(ray, ray))
        absorbs = self._absorbs[self._world.material_ids[triangle]]
        return np.where(seen, self._world.labels[triangle], -1), distance, facing, absorbs

    def clearance(self, place: Array) -> float:
        """Distance of a place [3] to the nearest surface, metres."""
        return clearance(self._world.triangles, place)

    def view(self, camera_from_world: Array, intrinsics: Array, height: int, width: int) -> View:
        """As that of :class:`~torchjoint_lab.synthetic.furnished.render.Renderer`, a little coarser."""
        turn = camera_from_world[:3, :3].astype(np.float32)
        eye = (-camera_from_world[:3, :3].T @ camera_from_world[:3, 3]).astype(np.float32)
        grids = [_directions(turn, intrinsics, height, width, shift) for shift in (0.0, -0.5)]
        ray = np.concatenate([grid.reshape(-1, 3) for grid in grids])
        triangle, depth, place = self._rays.cast(np.concatenate([np.broadcast_to(eye, ray.shape), ray], axis=1))
        seen = np.isfinite(depth)
        corners = np.take(self._world.corners, triangle, axis=0)
        u, v = place[:, :1], place[:, 1:]
        values = corners[:, 0] * (1 - u - v) + corners[:, 1] * u + corners[:, 2] * v
        material = self._world.material_ids[triangle]
        albedo = self._albedo(material, values[:, 3:])
        count = height * width
        hit = np.flatnonzero(seen[:count])
        parity = (np.arange(height)[:, None] % 2 * 2 + np.arange(width)[None] % 2).reshape(-1)
        light = np.zeros((count, 6), dtype=np.float32)
        light[hit] = self._light(eye, ray[hit], depth[hit], triangle[hit], values[hit, :3], parity[hit])
        facing = np.abs(_dot(np.take(self._face_normals, triangle[:count], axis=0), ray[:count]))
        facing = facing / np.sqrt(_dot(ray[:count], ray[:count]))
        labels = np.where(seen, self._world.labels[triangle], -1)
        shape = (height, width)
        centre = light.reshape(*shape, 6)
        at_corner = _spread(centre, labels[:count].reshape(shape), labels[count:].reshape(height + 1, width + 1))
        inner = self._colour(albedo[:count], light, seen[:count]).reshape(*shape, 3)
        outer = self._colour(albedo[count:], at_corner.reshape(-1, 6), seen[count:]).reshape(height + 1, width + 1, 3)
        around = outer[1:, 1:] + outer[:-1, 1:] + outer[1:, :-1] + outer[:-1, :-1]
        absorbs = self._absorbs[material[:count]]
        valid = seen[:count]
        return View(
            light=0.5 * inner + 0.125 * around,
            labels=labels[:count].reshape(shape),
            depth=np.where(valid, depth[:count], np.float32(0)).reshape(shape),
            facing=np.where(valid, facing, np.float32(0)).reshape(shape),
            absorbs=np.where(valid, absorbs, np.float32(0)).reshape(shape),
        )

    def _colour(self, albedo: Array, light: Array, seen: Array) -> Array:
        shaded = albedo * light[:, :3] + light[:, 3:]
        return np.where(seen[:, None], shaded, self._sky).astype(np.float32)

    def _light(self, eye: Array, ray: Array, depth: Array, triangle: Array, normal: Array, parity: Array) -> Array:
        """[S, 6] of S hits: irradiance and highlight, linear RGB each."""
        flat = np.take(self._face_normals, triangle, axis=0)
        flat = flat * -np.sign(_dot(flat, ray))[:, None]
        normal = normal * np.sign(_dot(normal, flat))[:, None]
        normal = normal / np.maximum(np.sqrt(_dot(normal, normal)), 1e-6)[:, None]
        gaze = -ray / np.sqrt(_dot(ray, ray))[:, None]
        start = eye + ray * depth[:, None] + flat * np.float32(_OFFSET) * np.maximum(depth, 1)[:, None]
        gloss = self._gloss[self._world.material_ids[triangle]]
        sky = np.float32(self._world.ambient) * (0.75 + 0.25 * normal[:, 2]) * self._open_sky(start, flat, parity)
        result = np.zeros((len(ray), 6), dtype=np.float32)
        result[:, :3] = sky[:, None]
        for lamp in self._world.lights:
            strength, lobe = self._lamp(lamp, start, normal, flat, gaze, parity)
            power = lamp.power.astype(np.float32)
            result[:, :3] += strength[:, None] * power
            result[:, 3:] += (0.6 * gloss * lobe * strength)[:, None] * power
        return result


def _directions(turn: Array, intrinsics: Array, height: int, width: int, shift: float) -> Array:
    """[H, W, 3] float32 rays through the pixels' centres; with ``shift`` -0.5 [H + 1, W + 1, 3] through the corners."""
    more = 0 if shift == 0 else 1
    x = ((np.arange(width + more) + shift - intrinsics[0, 2]) / intrinsics[0, 0]).astype(np.float32)[None]
    y = ((np.arange(height + more) + shift - intrinsics[1, 2]) / intrinsics[1, 1]).astype(np.float32)[:, None]
    # Written out, for a BLAS product might round by the number of its threads.
    return np.stack([x * turn[0, i] + y * turn[1, i] + turn[2, i] for i in range(3)], axis=-1)


def _spread(light: Array, labels: Array, corner_labels: Array) -> Array:
    """[H + 1, W + 1, 6] light for the corners: of one of the four centres around that is on the same instance."""
    places = np.pad(np.arange(labels.size, dtype=np.int32).reshape(labels.shape), 1, mode="edge")
    around = np.pad(labels, 1, mode="edge")
    h, w = corner_labels.shape
    source = places[:h, :w]
    for row, column in ((0, 1), (1, 0), (1, 1)):
        same = around[row : row + h, column : column + w] == corner_labels
        source = np.where(same, places[row : row + h, column : column + w], source)
    return np.asarray(np.take(light.reshape(-1, light.shape[2]), source, axis=0))


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1] + a[:, 2] * b[:, 2])
