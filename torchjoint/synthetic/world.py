"""A world under construction: items (objects with parts and places to put things on) become labelled triangles."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from torchjoint.synthetic.arrays import Array
from torchjoint.synthetic.materials import Material
from torchjoint.synthetic.mesh import Part, rotation_z

#: What makes an instance hard to find: "flat" things lie flush on the surface below, or hang flush on a wall;
#: "concave" ones are hollow.
KINDS = ("flat", "concave", "other")
#: Greatest thickness of a flat thing, metres.
FLAT = 0.015


@dataclass(frozen=True)
class Pose:
    """Where an item stands: metres, and ``yaw`` radians about z."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    yaw: float = 0.0

    def at(self, x: float, y: float, z: float = 0.0, yaw: float = 0.0) -> Pose:
        """The world pose of what stands at (x, y, z, yaw) in this pose's own frame."""
        dx, dy, _ = rotation_z(self.yaw) @ np.array([x, y, 0.0])
        return Pose(self.x + dx, self.y + dy, self.z + z, self.yaw + yaw)


@dataclass(frozen=True)
class Surface:
    """A level rectangle that things can stand on, in its item's frame, metres.

    Attributes:
        low, high: least and greatest (x, y).
        z: height.
        headroom: free height above.
    """

    low: tuple[float, float]
    high: tuple[float, float]
    z: float
    headroom: float = 9.0


@dataclass(frozen=True)
class Front:
    """An upright rectangle that things can be fixed to, facing -y, in its item's frame, metres.

    Attributes:
        low, high: least and greatest (x, z).
        y: where it is.
        material: its own.
    """

    low: tuple[float, float]
    high: tuple[float, float]
    y: float
    material: Material


@dataclass
class Item:
    """One instance: its parts, with the front towards -y and the origin in the middle of its foot.

    Attributes:
        name: what it is; several instances may share it.
        size: (x, y, z) extent, metres.
        parts: triangles and their material.
        surfaces: where things can be put.
        fronts: where things can be fixed.
        hollow: whether its inside can be seen, as a bowl's.
    """

    name: str
    size: tuple[float, float, float]
    parts: list[tuple[Part, Material]]
    surfaces: list[Surface] = field(default_factory=list)
    fronts: list[Front] = field(default_factory=list)
    hollow: bool = False

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
    """Everything the renderer needs.

    Attributes:
        triangles: [T, 3, 3] float32 corners, metres, z up.
        corners: [T, 3, 5] float32 shading normal and uv at the corners.
        labels: [T] int64 instance ids.
        material_ids: [T] index into ``materials``.
        names: instance id -> name.
        kinds: instance id -> one of :data:`KINDS`.
        ambient: light that comes from everywhere, linear.
        room: (x, y, z) extent; the floor is z = 0, its middle the origin.
        focus: (x, y, half x, half y) of the furniture group that the camera walks around.
    """

    triangles: Array
    corners: Array
    labels: Array
    material_ids: Array
    materials: tuple[Material, ...]
    names: tuple[str, ...]
    kinds: tuple[str, ...]
    lights: tuple[Light, ...]
    ambient: float
    room: tuple[float, float, float]
    focus: tuple[float, float, float, float]


class WorldBuilder:
    """Collects placed items; :meth:`place` gives each the next instance id."""

    def __init__(self) -> None:
        self.placed: list[tuple[Item, Pose]] = []
        self._materials: list[Material] = []
        self._chunks: list[tuple[Array, Array, int, int]] = []

    def place(self, item: Item, pose: Pose) -> Pose:
        """Adds ``item`` as a new instance; returns ``pose``, for what is to be put on it."""
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
        """The finished world."""
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
