"""Where the cameras of a domain's scene stand and look."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from torchjoint_lab.synthetic.furnished import trajectory
from torchjoint_lab.synthetic.furnished.arrays import Array, Rng
from torchjoint_lab.synthetic.furnished.world import World
from torchjoint_lab.synthetic.quick_render import QuickRenderer

#: Nothing is nearer to a camera than this, metres.
_CLEAR = 0.15

#: Distances to try if all nearer ones are taken, as multiples of the first.
_OUTWARD = np.arange(1.1, 2.05, 0.1)


class Cameras(Protocol):
    """Anything that places cameras."""

    def poses(self, rng: Rng, renderer: QuickRenderer, count: int) -> list[Array]:
        """[4, 4] world-to-camera poses."""


class Walk(NamedTuple):
    """A hand-held walk around the middle of a furnished room."""

    world: World

    def poses(self, rng: Rng, renderer: QuickRenderer, count: int) -> list[Array]:
        """[4, 4] world-to-camera poses."""
        return trajectory.walk(rng, self.world, count)


class Mount(NamedTuple):
    """Cameras on a car's roof, ``offset`` metres below its LiDAR, looking forward (+x) and around."""

    offset: float

    def poses(self, rng: Rng, renderer: QuickRenderer, count: int) -> list[Array]:
        """[4, 4] world-to-camera poses."""
        poses = []
        for i in range(count):
            turn = 2 * np.pi * i / count + rng.normal(0, 0.03)
            out = np.array([np.cos(turn), np.sin(turn), 0.0])
            eye = 0.35 * out + [0, 0, -self.offset]
            poses.append(look_at(eye, eye + out + [0, 0, rng.normal(-0.05, 0.02)], float(rng.normal(0, 0.01))))
        return poses


class Rig(NamedTuple):
    """The rule by which cameras are placed around a target.

    Attributes:
        target: [3] what they look at, metres.
        spread: [3] standard deviation of where exactly they look.
        distance: least and greatest, metres.
        elevation: least and greatest, radians.
        azimuth: the middle of the arc, radians.
        arc: half its width.
        low, high: [3] the box that cameras must stay in.
    """

    target: tuple[float, float, float]
    spread: tuple[float, float, float]
    distance: tuple[float, float]
    elevation: tuple[float, float]
    azimuth: float
    arc: float
    low: tuple[float, float, float] = (-1e3, -1e3, 0.05)
    high: tuple[float, float, float] = (1e3, 1e3, 1e3)

    def poses(self, rng: Rng, renderer: QuickRenderer, count: int) -> list[Array]:
        """[4, 4] world-to-camera poses: a sweep over the arc and back, not too near to anything.

        A place that is too near to something is first moved towards the target, then away from it.
        """
        phase, swings = rng.uniform(-np.pi, np.pi), rng.uniform(0.4, 1.2)
        part = np.linspace(-1, 1, count) if count > 1 else rng.uniform(-1, 1, 1)
        wave = np.sin(phase + swings * np.pi * part)
        reach = rng.uniform(*self.distance)
        poses = []
        for i in range(count):
            for attempt in range(12):
                turn = self.azimuth + self.arc * part[i] + rng.normal(0, 0.05)
                rise = np.clip(np.mean(self.elevation) + np.ptp(self.elevation) / 2 * wave[i], *self.elevation)
                away = np.clip(reach * np.exp(rng.normal(0, 0.08)), *self.distance) * (0.93**attempt)
                out = np.array([np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), np.sin(rise)])
                target = np.asarray(self.target) + rng.normal(0, 1, 3) * self.spread
                eye = np.clip(np.asarray(self.target) + out * away, self.low, self.high)
                if renderer.clearance(eye) > _CLEAR:
                    break
            else:  # going nearer only led into a high heap: out of it again
                ways = (np.clip(self.target + out * step * reach, self.low, self.high) for step in _OUTWARD)
                eye = next((way for way in ways if renderer.clearance(way) > _CLEAR), eye)
            poses.append(look_at(eye, target, float(rng.normal(0, 0.04))))
        return poses


def look_at(eye: Array, target: Array, roll: float) -> Array:
    """[4, 4] world-to-camera pose, OpenCV axes, upright but for ``roll`` radians; also for cameras that look down."""
    z = (target - eye) / np.linalg.norm(target - eye)
    up = np.array([0.0, 0.0, 1.0]) if abs(z[2]) < 0.995 else np.array([0.0, 1.0, 0.0])
    x = np.cross(z, up)
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    c, s = np.cos(roll), np.sin(roll)
    rotation = np.stack([c * x + s * y, c * y - s * x, z])
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = -(rotation * eye).sum(axis=1)
    return pose
