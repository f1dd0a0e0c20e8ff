"""A world whose things lie, lean and pile up: with any rotation, in contact with earlier things."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from torchjoint_lab.synthetic.furnished.arrays import Array, Rng
from torchjoint_lab.synthetic.furnished.materials import Material
from torchjoint_lab.synthetic.furnished.world import Item, Light, World
from torchjoint_lab.synthetic.solids import euler, turned

_UPRIGHT = np.eye(3)
#: Points that stand for a thing's surface while it is tried, and the most when it is put down.
_COARSE, _DENSE = 700, 60_000


class Stage:
    """Collects turned items, each an instance of its own."""

    def __init__(self) -> None:
        self.names: list[str] = []
        self.kinds: list[str] = []
        self._materials: dict[int, int] = {}
        self._kept: list[Material] = []
        self._chunks: list[tuple[Array, Array, int, int]] = []

    def add(self, item: Item, rotation: Array = _UPRIGHT, offset: Sequence[float] | Array = (0, 0, 0)) -> int:
        """Adds ``item``, turned by ``rotation`` [3, 3] and moved by ``offset`` metres; returns its instance."""
        label = len(self.names)
        self.names.append(item.name)
        self.kinds.append(item.kind)
        for part, material in item.parts:
            moved = turned(part, rotation, offset)
            corners = np.concatenate([moved.normals, moved.uv], axis=2)
            self._chunks.append((moved.positions, corners, label, self._material_id(material)))
        return label

    def stand(self, item: Item, x: float, y: float, z: float = 0.0, yaw: float = 0.0) -> int:
        """Adds ``item`` upright at (x, y, z) metres."""
        return self.add(item, euler(yaw), (x, y, z))

    def _material_id(self, material: Material) -> int:
        if id(material) not in self._materials:
            self._materials[id(material)] = len(self._kept)
            self._kept.append(material)
        return self._materials[id(material)]

    def build(self, lights: tuple[Light, ...], ambient: float) -> World:
        """The finished world. Its room and focus mean nothing: cameras of these worlds have their own rules."""
        counts = [len(chunk[0]) for chunk in self._chunks]
        return World(
            triangles=np.concatenate([chunk[0] for chunk in self._chunks]).astype(np.float32),
            corners=np.concatenate([chunk[1] for chunk in self._chunks]).astype(np.float32),
            labels=np.repeat(np.array([chunk[2] for chunk in self._chunks], dtype=np.int64), counts),
            material_ids=np.repeat(np.array([chunk[3] for chunk in self._chunks], dtype=np.int64), counts),
            materials=tuple(self._kept),
            names=tuple(self.names),
            kinds=tuple(self.kinds),
            lights=lights,
            ambient=ambient,
            room=(0.0, 0.0, 0.0),
            focus=(0.0, 0.0, 0.0, 0.0),
        )


@dataclass(frozen=True)
class Body:
    """A thing and points all over its surface.

    Attributes:
        item: the thing.
        points: [P, 3] spread evenly over its surface, in its own frame, metres.
        centre: [3] their mean, which stands for its centre of mass.
    """

    item: Item
    points: Array
    centre: Array

    @staticmethod
    def of(rng: Rng, item: Item, cell: float) -> Body:
        """Samples an item so densely that no ``cell`` metres wide is left out."""
        triangles = np.concatenate([part.positions for part, _ in item.parts])
        edges = triangles[:, 1:] - triangles[:, :1]
        area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1) / 2
        count = int(np.clip(4 * area.sum() / cell**2, _COARSE, _DENSE))
        edge = np.cumsum(area)
        chosen = np.searchsorted(edge, (np.arange(count) + rng.random()) / count * edge[-1])
        chosen = np.minimum(chosen, len(area) - 1)
        a, b = rng.random((2, count, 1))
        over = a + b > 1
        a, b = np.where(over, 1 - a, a), np.where(over, 1 - b, b)
        points = triangles[chosen, 0] + a * edges[chosen, 0] + b * edges[chosen, 1]
        shuffled = rng.permutation(count)
        corners = triangles.reshape(-1, 3)
        if len(corners) <= 6000:  # corners touch first
            points = np.concatenate([corners, points[shuffled]])
            return Body(item, points, points[len(corners) :].mean(axis=0))
        return Body(item, points[shuffled], points.mean(axis=0))

    def coarse(self) -> Array:
        """[K, 3] some of the points."""
        step = max(len(self.points) // _COARSE, 1)
        return self.points[::step]


class Heights:
    """How high the things on a support reach: a grid over a rectangle.

    Args:
        low, high: least and greatest (x, y), metres; beyond them a thing finds no support, at -1000 m, unless
            ``walls``: then nothing can reach beyond.
        z: of the support.
        cell: metres.
        walls: whether things must stay within.
    """

    def __init__(self, low: Sequence[float], high: Sequence[float], z: float, cell: float, walls: bool = True) -> None:
        self.low, self.high, self.base, self.cell = np.asarray(low), np.asarray(high), z, cell
        size = np.ceil((self.high - self.low) / cell).astype(int)
        self.grid = np.full((size[0] + 2, size[1] + 2), z)
        edge = 1e3 if walls else -1e3
        self.grid[[0, -1]] = edge
        self.grid[:, [0, -1]] = edge

    def cells(self, points: Array) -> tuple[Array, Array]:
        """Row and column [...] of the grid for [..., 2 or 3] points; those beyond it are on its rim."""
        index = np.floor((points[..., :2] - self.low) / self.cell).astype(np.int64) + 1
        return (
            np.clip(index[..., 0], 0, self.grid.shape[0] - 1),
            np.clip(index[..., 1], 0, self.grid.shape[1] - 1),
        )

    def contact(self, points: Array) -> Array:
        """[...] how far [..., P, 3] points must be lifted to rest on the earlier things."""
        row, column = self.cells(points)
        return np.asarray((self.grid[row, column] - points[..., 2]).max(axis=-1))

    def at(self, spots: Array) -> Array:
        """[...] how high it is at [..., 2] spots."""
        return np.asarray(self.grid[self.cells(spots)])

    def share(self, other: Heights) -> None:
        """Takes over what ``other`` knows of the places that both have."""
        rows, columns = (np.arange(1, n - 1) for n in self.grid.shape)
        x, y = (self.low[i] + (index - 0.5) * self.cell for i, index in ((0, rows), (1, columns)))
        spots = np.stack(np.broadcast_arrays(x[:, None], y[None]), axis=-1)
        inside = ((spots > other.low) & (spots < other.high)).all(axis=-1)
        known = np.where(inside, other.at(spots), -np.inf)
        self.grid[1:-1, 1:-1] = np.maximum(self.grid[1:-1, 1:-1], known)

    def put(self, points: Array) -> None:
        """Takes note of what lies at [P, 3]."""
        row, column = self.cells(points)
        inside = (row > 0) & (row < self.grid.shape[0] - 1) & (column > 0) & (column < self.grid.shape[1] - 1)
        np.maximum.at(self.grid, (row[inside], column[inside]), points[inside, 2])
