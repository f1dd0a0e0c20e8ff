"""A room of convex solids, a table with things, chairs and cabinets; and what rays see of it. Vectors are [3, ...]."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
Rng = np.random.Generator

_FLAT = 0.015  #: thickness of what is flat on a wall or a cabinet, metres
#: Paints: white, two woods, grey, red, blue, green, yellow, pale blue, orange; [10, 3] in [0, 1].
_PAINTS = 0xEDEBE3, 0x8C6645, 0xB89166, 0x4D4F57, 0xBF2E26, 0x29549E, 0x338552, 0xE3AD33, 0x8CB3C7, 0xD98552
_COLORS = np.stack([np.array(_PAINTS) >> shift & 255 for shift in (16, 8, 0)], 1) / 255
_SIDES, _CORNERS = (-1, 1), ((-1, -1), (-1, 1), (1, -1), (1, 1))


def dot(a: Any, b: Any) -> Array:
    """Sums over the first axis, of 3. It is written out: BLAS may round otherwise with another number of threads."""
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


class Paint:
    """Two colours in a pattern that repeats after `size` metres of the solid; `rng` draws what is not given."""

    def __init__(self, rng: Rng, color: int | None = None, pattern: str | None = None, size: float = 0.06) -> None:
        one, two = rng.choice(len(_COLORS), 2, replace=False)
        self.pattern = pattern or str(rng.choice(["grain", "grain", "stripes", "checks", "print"]))
        self.first = _COLORS[one if color is None else color] * rng.uniform(0.85, 1.0, 3)
        self.second = self.first * rng.uniform(0.75, 0.9) if self.pattern == "grain" else _COLORS[two]
        self.wave, self.cell = rng.normal(size=3), size / 2
        self.wave *= np.pi / self.cell / np.linalg.norm(self.wave)

    def at(self, place: Array) -> Array:
        """The colours [K, 3] at places [3, K] of the solid."""
        cells, along = np.floor(place / self.cell + 0.4), dot(self.wave, place)
        if self.pattern == "grain":
            share = 0.5 + 0.5 * np.sin(along + 2 * np.sin(dot((9, 14, 7), place)))
        elif self.pattern == "stripes":
            share = np.sin(along) > 0.3
        else:  # checks; or prints, whose cells have random shares
            share = cells.sum(0) % 2 if self.pattern == "checks" else np.sin(dot((13, 78, 37), cells)) * 43758.5 % 1
        return self.first + share[:, None] * (self.second - self.first)


class Solid(NamedTuple):
    """A convex solid."""

    corners: Array  #: [3, V] metres, world frame
    faces: list[list[int]]  #: corners of each face, counterclockwise as seen from outside
    normals: Array  #: [3, F] unit, outward
    origin: Array  #: [3] its own origin
    yaw: float  #: of its own axes, radians about z

    def moved(self, place: Sequence[float], yaw: float = 0.0) -> Solid:
        """Returns the solid turned by `yaw` radians about z, and then moved by `place` metres."""
        corners, normals, origin = (_turned(of, yaw) for of in (self.corners, self.normals, self.origin))
        return Solid(corners + np.array(place)[:, None], self.faces, normals, origin + place, self.yaw + yaw)

    def triangles(self) -> Array:
        """[T, 3, 3] float32, the surface."""
        fans = [(face[0], *pair) for face in self.faces for pair in pairwise(face[1:])]
        return self.corners.T[np.array(fans)].astype(np.float32)


def lathe(profile: Sequence[tuple[float, float]], sides: int = 16, x: float = 1.0, y: float = 1.0) -> Solid:
    """A convex solid with `sides` corners at each radius and height, metres, of `profile`; stretched along x and y."""
    angle = (np.arange(sides) + 0.5) * 2 * np.pi / sides
    rings = [(r * x * np.cos(angle), r * y * np.sin(angle), np.full(sides, z)) for r, z in profile]
    last, around = sides * (len(rings) - 1), [(k, (k + 1) % sides) for k in range(sides)]
    faces = [list(range(sides))[::-1], list(range(last, last + sides))]
    faces += [[low + i, low + j, low + j + sides, low + i + sides] for low in range(0, last, sides) for i, j in around]
    corners = np.concatenate(rings, axis=1)
    first, second, third = (corners[:, [face[k] for face in faces]] for k in range(3))
    normals = np.cross(second - first, third - second, axis=0)
    return Solid(corners, faces, normals / np.linalg.norm(normals, axis=0), np.zeros(3), 0.0)


def box(x: float, y: float, z: float, place: Sequence[float] = (0.0, 0.0, 0.0)) -> Solid:
    """A box of these edges, metres; the middle of its foot is at `place`."""
    return lathe([(0.5**0.5, 0.0), (0.5**0.5, z)], 4, x, y).moved(place)


def _cup(radius: float, height: float, sides: int) -> list[Solid]:
    """A hollow vessel: a foot, and staves around it."""
    stave = box(2 * radius * np.tan(np.pi / sides), 0.006, height, (0.0, radius, 0.0))
    foot = lathe([(radius, 0.0), (radius, 0.006)], sides)
    return [foot, *(stave.moved((0.0, 0.0, 0.0), 2 * np.pi * k / sides) for k in range(sides))]


def _turned(vectors: Array, yaw: float) -> Array:
    c, s = np.cos(yaw), np.sin(yaw)
    return np.stack([c * vectors[0] - s * vectors[1], s * vectors[0] + c * vectors[1], vectors[2]])


class Thing(NamedTuple):
    """One instance."""

    name: str
    kind: str  #: "flat", "concave" or "other"
    solids: list[Solid]
    paint: Paint

    def moved(self, place: Sequence[float], yaw: float = 0.0) -> Thing:
        """Returns the thing turned by `yaw` radians about z, and then moved by `place` metres."""
        return self._replace(solids=[solid.moved(place, yaw) for solid in self.solids])


def _small_thing(rng: Rng) -> Thing:
    """A thing on the origin, at most 0.28 m wide."""
    name = str(rng.choice(["box", "box", "cup", "bowl", "ball", "can", "book", "book", "paper", "tray"]))
    r, (x, y, z) = rng.uniform(0.035, 0.05), rng.uniform((0.12, 0.1, 0.06), (0.22, 0.17, 0.24))
    kind = {"cup": "concave", "bowl": "concave", "tray": "concave", "paper": "flat"}.get(name, "other")
    walls = [(0.008, y, side * x / 2, 0.0) for side in _SIDES] + [(x, 0.008, 0.0, side * y / 2) for side in _SIDES]
    solids = {
        "box": lambda: [box(x, y, z)],
        "cup": lambda: _cup(r, 0.1, 10),
        "bowl": lambda: _cup(1.8 * r, 1.3 * r, 14),
        "ball": lambda: [lathe([(r * np.sin(t), r * (1 - np.cos(t))) for t in np.linspace(0.2, np.pi - 0.2, 8)])],
        "can": lambda: [lathe([(r, 0.0), (r, 2.5 * r)])],
        "book": lambda: [box(0.8 * x, 1.4 * y, 0.7 * r)],
        "paper": lambda: [box(0.15, 0.21, 0.002)],
        "tray": lambda: [box(x, y, 0.008), *(box(a, b, 0.07, (i, j, 0.0)) for a, b, i, j in walls)],
    }
    return Thing(name, kind, solids[name](), Paint(rng, size=rng.uniform(0.03, 0.08)))


def _strewn(rng: Rng, width: float, depth: float, share: float) -> Iterator[Thing]:
    """Things on a rectangle around the origin, one on a `share` of its cells; some carry another one."""
    columns, rows = int(width / 0.27), int(depth / 0.27)
    for column, row in np.ndindex(columns, rows):
        if rng.random() < share:
            thing, yaw = _small_thing(rng), rng.uniform(-0.5, 0.5)
            x, y = ((column + 0.5) / columns - 0.5) * width, ((row + 0.5) / rows - 0.5) * depth
            yield thing.moved((x, y, 0.0), yaw)
            if thing.name in ("box", "book") and rng.random() < 0.4:
                yield _small_thing(rng).moved((x, y, thing.solids[0].corners[2].max()), -yaw)


def _table(rng: Rng, share: float) -> Iterator[Thing]:
    """A table with things on it, and two or three chairs."""
    x, y, z = rng.uniform((1.2, 0.75, 0.7), (1.7, 1.0, 0.76))
    top = box(x, y, 0.03, (0.0, 0.0, z - 0.03))
    legs = [box(0.06, 0.06, z - 0.03, (i * (0.5 * x - 0.06), j * (0.5 * y - 0.06), 0.0)) for i, j in _CORNERS]
    yield Thing("table", "other", [top, *legs], Paint(rng, int(rng.integers(3)), "grain"))
    legs = [box(0.04, 0.04, 0.42, (0.17 * i, 0.17 * j, 0.0)) for i, j in _CORNERS]
    seat, back = box(0.4, 0.4, 0.04, (0.0, 0.0, 0.42)), box(0.4, 0.03, 0.4, (0.0, 0.19, 0.46))
    chair = Thing("chair", "other", [seat, back, *legs], Paint(rng))
    places = [(x / 4, y / 2, 0.0), (-x / 4, y / 2, np.pi), (0.0, x / 2, np.pi / 2)]
    for along, away, turn in places[: rng.integers(2, 4)]:
        yield chair.moved((along, away + 0.14, 0.0), rng.uniform(-0.3, 0.3)).moved((0.0, 0.0, 0.0), turn)
    yield from (thing.moved((0.0, 0.0, z)) for thing in _strewn(rng, x - 0.06, y - 0.06, share))


def _at_wall(rng: Rng, share: float) -> Iterator[Thing]:
    """A cabinet with doors and things, and a picture: the wall's foot is the x axis, the room is at negative y."""
    x, y, z = rng.uniform((0.7, 0.35, 0.7), (1.3, 0.5, 1.1))
    at, paint = rng.uniform(-0.4, 0.4), Paint(rng, int(rng.integers(5)), "grain")
    yield Thing("cabinet", "other", [box(x, y, z, (at, -y / 2 - 0.01, 0.0))], paint)
    for middle in (at - x / 4, at + x / 4):
        yield Thing("door", "flat", [box(x / 2 - 0.03, _FLAT, z - 0.1, (middle, -y - 0.01 - _FLAT / 2, 0.06))], paint)
    yield from (thing.moved((at, -y / 2, z)) for thing in _strewn(rng, x, y, share))
    picture = box(rng.uniform(0.4, 0.9), _FLAT, rng.uniform(0.3, 0.6), (at, -_FLAT / 2, rng.uniform(1.3, 1.5)))
    yield Thing("picture", "flat", [picture], Paint(rng, size=0.2))


def furnish(rng: Rng, clutter: float) -> tuple[tuple[float, float, float], list[Thing]]:
    """Furnishes a room around the origin: its size, metres, and its things, the more the larger `clutter` in [0, 1]."""
    x, y, z = (float(edge) for edge in rng.uniform((4.0, 3.8, 2.4), (5.0, 4.6, 2.7)))
    things = [Thing("floor", "other", [box(x + 1, y + 1, 0.1, (0.0, 0.0, -0.1))], Paint(rng, 1, "grain", 0.15))]
    plaster, share = Paint(rng, 0, "grain", 0.6), 0.8 + 0.2 * clutter
    for quarter, (length, away) in enumerate([(x, y), (y, x)] * 2):
        wall = Thing("wall", "other", [box(length, 0.1, z, (0.0, 0.05, 0.0))], plaster)
        side = [wall, *(_at_wall(rng, share) if rng.random() < 0.75 else [])]
        things += [one.moved((0.0, away / 2, 0.0)).moved((0.0, 0.0, 0.0), quarter * np.pi / 2) for one in side]
    yaw = rng.uniform(-0.4, 0.4)
    return (x, y, z), [*things, *(thing.moved((0.0, 0.0, 0.0), yaw) for thing in _table(rng, share))]


class View(NamedTuple):
    """What rays hit; where they hit nothing, labels are -1 and the rest is 0."""

    labels: Array  #: [H, W] int64, index of the thing
    depth: Array  #: [H, W] metres along the camera's z
    facing: Array  #: [H, W] cosine between ray and surface normal
    light: Array  #: [H, W, 3] in [0, 1], below a lamp over the table


def look(things: list[Thing], camera: Array, pose: Array, size: Sequence[int]) -> View:
    """Casts a ray through each pixel's centre: intrinsics [3, 3], world-to-camera pose [4, 4], size (H, W)."""
    row, column = np.mgrid[: size[0], : size[1]].astype(float)
    ahead = ((column - camera[0, 2]) / camera[0, 0], (row - camera[1, 2]) / camera[1, 1], np.ones(size))
    rays, eye = np.stack([dot(pose[:3, i], ahead) for i in range(3)]), -dot(pose[:3, :3], pose[:3, 3])
    depth, index, face, normal = np.full(size, np.inf), np.full(size, -1), np.zeros(size, int), np.zeros((3, *size))
    solids = [(label, solid) for label, thing in enumerate(things) for solid in thing.solids]
    for number, (_, solid) in enumerate(solids):
        if not (within := rays[:, *(window := _window(solid, camera, pose, size))]).size:
            continue
        entry, entered = _enter(solid, eye, within)
        nearer = entry < depth[window]
        depth[window][nearer], index[window][nearer], face[window][nearer] = entry[nearer], number, entered[nearer]
    labels, color = np.full(size, -1), np.zeros((*size, 3))
    for number in np.unique(index[index >= 0]):
        here, (label, solid) = index == number, solids[number]
        place = eye[:, None] + rays[:, here] * depth[here] - solid.origin[:, None]
        labels[here], color[here] = label, things[label].paint.at(_turned(place, -solid.yaw))
        normal[:, here] = solid.normals[:, face[here]]
    depth[index < 0] = 0
    lamp = (np.array([0.0, 0.0, 2.3]) - eye)[:, None, None] - rays * depth
    distance = np.sqrt(dot(lamp, lamp))
    light = 0.45 + 0.55 * np.maximum(dot(normal, lamp) / distance, 0) / (0.7 + 0.1 * distance**2)
    return View(labels, depth, -dot(normal, rays) / np.sqrt(dot(rays, rays)), np.clip(color * light[..., None], 0, 1))


def _window(solid: Solid, camera: Array, pose: Array, size: Sequence[int]) -> tuple[slice, slice]:
    """The rows and columns of an image in which a solid can be seen; none if one side of the view has all of it."""
    x, y, z = (dot(pose[i, :3], solid.corners) + pose[i, 3] for i in range(3))
    row, column = camera[1, 1] * y + camera[1, 2] * z, camera[0, 0] * x + camera[0, 2] * z
    inward = np.stack([z, row, column, (size[0] - 1) * z - row, (size[1] - 1) * z - column])
    if (beyond := inward.max(1).min() <= 0) or z.min() < 0.05:
        return slice(0 if beyond else None), slice(None)
    low, high = (np.maximum([f(row / z), f(column / z)], 0).astype(int) for f in (np.min, np.max))
    return slice(low[0], high[0] + 2), slice(low[1], high[1] + 2)


def _enter(solid: Solid, eye: Array, rays: Array) -> tuple[Array, Array]:
    """Where rays [3, ...] enter a solid, in lengths of the ray (inf where they miss it), and the face there."""
    entry, leave, face = np.zeros(rays.shape[1:]), np.full(rays.shape[1:], np.inf), np.zeros(rays.shape[1:], int)
    with np.errstate(divide="ignore", invalid="ignore"):
        for number, normal in enumerate(solid.normals.T):
            away, closing = dot(normal, eye - solid.corners[:, solid.faces[number][0]]), -dot(normal, rays)
            at = np.where(closing * away > 0, away / closing, np.inf)
            if away > 0:  # the eye is before this face
                face[at > entry] = number
                entry = np.maximum(entry, at)
            else:
                leave = np.minimum(leave, at)
    entry[entry >= leave] = np.inf
    return entry, face
