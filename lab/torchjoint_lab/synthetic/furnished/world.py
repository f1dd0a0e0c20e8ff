"""Builds a world: items (objects with parts, and surfaces for other items) become labelled triangles."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from torchjoint_lab.synthetic.furnished.arrays import Array
from torchjoint_lab.synthetic.furnished.materials import Material
from torchjoint_lab.synthetic.furnished.mesh import Part, rotation_z

#: Why an instance is hard to segment: "flat" items lie flush on the surface below or hang flush on a wall; "concave"
#: items are hollow.
KINDS = ("flat", "concave", "other")
#: Largest thickness of a flat item, metres.
FLAT = 0.015


@dataclass(frozen=True)
class Pose:
    """Pose of an item: position in metres, and ``yaw`` in radians about z."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    yaw: float = 0.0

    def at(self, x: float, y: float, z: float = 0.0, yaw: float = 0.0) -> Pose:
        """Returns the world pose of an item at (x, y, z, yaw) in the frame of this pose."""
        dx, dy, _ = rotation_z(self.yaw) @ np.array([x, y, 0.0])
        return Pose(self.x + dx, self.y + dy, self.z + z, self.yaw + yaw)


@dataclass(frozen=True)
class Surface:
    """A level rectangle on which items can stand, in the frame of its item, metres."""

    low: tuple[float, float]  #: least and greatest (x, y)
    high: tuple[float, float]
    z: float  #: height
    headroom: float = 9.0  #: free height above


@dataclass(frozen=True)
class Front:
    """An upright rectangle, facing -y, to which items can be fixed, in the frame of its item, metres."""

    low: tuple[float, float]  #: least and greatest (x, z)
    high: tuple[float, float]
    y: float  #: its position
    material: Material  #: its material


@dataclass
class Item:
    """One instance; its front is towards -y, and the origin is the middle of its foot."""

    name: str  #: kind of object; several instances may share it
    size: tuple[float, float, float]  #: (x, y, z) extent, metres
    parts: list[tuple[Part, Material]]  #: triangles and their materials
    surfaces: list[Surface] = field(default_factory=list)  #: where items can stand
    fronts: list[Front] = field(default_factory=list)  #: where items can be fixed
    hollow: bool = False  #: whether the camera can see its inside, as in a bowl

    @property
    def kind(self) -> str:
        """One of :data:`KINDS`."""
        if self.hollow:
            return "concave"
        return "flat" if min(self.size[1:]) <= FLAT else "other"


@dataclass(frozen=True)
class Light:
    """A round lamp below the ceiling: ``position`` [3] and ``radius`` metres, ``power`` [3] linear RGB at 1 m."""

    position: Array
    radius: float
    power: Array


@dataclass(frozen=True)
class World:
    """All data that the renderer needs."""

    triangles: Array  #: [T, 3, 3] float32 corners, metres, z up
    corners: Array  #: [T, 3, 5] float32 shading normal and uv at the corners
    labels: Array  #: [T] int64 instance ids
    material_ids: Array  #: [T] index into ``materials``
    materials: tuple[Material, ...]
    names: tuple[str, ...]  #: instance id -> name
    kinds: tuple[str, ...]  #: instance id -> one of :data:`KINDS`
    lights: tuple[Light, ...]
    ambient: float  #: ambient light, linear
    room: tuple[float, float, float]  #: (x, y, z) extent; the floor is at z = 0, its middle at the origin
    #: (x, y, half x, half y) of the furniture group around which the camera walks
    focus: tuple[float, float, float, float]


class WorldBuilder:
    """Collects placed items; :meth:`place` gives each item the next instance id."""

    def __init__(self) -> None:
        self.placed: list[tuple[Item, Pose]] = []
        self._materials: list[Material] = []
        self._chunks: list[tuple[Array, Array, int, int]] = []

    def place(self, item: Item, pose: Pose) -> Pose:
        """Adds ``item`` as a new instance; returns ``pose``, for placing other items on it."""
        label = len(self.placed)
        self.placed.append((item, pose))
        for part, material in item.parts:
            moved = part.moved((pose.x, pose.y, pose.z), pose.yaw)
            corners = np.concatenate([moved.normals, moved.uv], axis=2)
            self._chunks.append((moved.positions, corners, label, self._material_id(material)))
        return pose

    def _material_id(self, material: Material) -> int:
        if material not in self._materials:
            self._materials.append(material)
        return self._materials.index(material)

    def build(
        self,
        lights: tuple[Light, ...],
        ambient: float,
        room: tuple[float, float, float],
        focus: tuple[float, float, float, float],
    ) -> World:
        """Returns the finished world."""
        counts = [len(chunk[0]) for chunk in self._chunks]
        return World(
            triangles=np.concatenate([chunk[0] for chunk in self._chunks]).astype(np.float32),
            corners=np.concatenate([chunk[1] for chunk in self._chunks]).astype(np.float32),
            labels=np.repeat(np.array([chunk[2] for chunk in self._chunks], dtype=np.int64), counts),
            material_ids=np.repeat(np.array([chunk[3] for chunk in self._chunks], dtype=np.int64), counts),
            materials=tuple(self._materials),
            names=tuple(item.name for item, _ in self.placed),
            kinds=tuple(item.kind for item, _ in self.placed),
            lights=lights,
            ambient=ambient,
            room=room,
            focus=focus,
        )
