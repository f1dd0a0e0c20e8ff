"""What a LiDAR at the origin sees in a tenth of a second, or several on one car."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from torchjoint_lab.synthetic.furnished.arrays import Array, Rng
from torchjoint_lab.synthetic.quick_render import QuickRenderer
from torchjoint_lab.synthetic.settings import DomainSettings

#: Nearest range that is returned, metres.
_NEAREST = 1.8
#: Seconds of a scan.
_TURN = 0.1


class Lidar(NamedTuple):
    """A kind of sensor. Points are in the frame of the car, whose origin is the sensor's place, or near it."""

    beams: int  #: rings of a turn; 0: no rings, but a rosette ahead, as of a solid-state sensor
    low: float  #: degrees, elevation of the lowest beam; of a rosette half of its height, negative
    high: float  #: degrees, elevation of the highest beam; of a rosette half of its width
    steps: int  #: rays of a ring, or of the rosette
    farthest: float = 80.0  #: metres, the largest range that is returned
    places: tuple[tuple[float, float, float], ...] = ((0.0, 0.0, 0.0),)  #: metres, a sensor at each
    speed: float = 0.0  #: metres a second along x; the points are not corrected for it


#: "16", "32" and "64" are those that streets draw.
LIDARS = {
    "16": Lidar(16, -15.0, 15.0, 1800),
    "32": Lidar(32, -30.0, 10.0, 1400),
    "64": Lidar(64, -24.8, 2.0, 1900),
    "128": Lidar(128, -25.0, 15.0, 1800, farthest=200.0),
    "near 32": Lidar(32, -55.0, 15.0, 1024, farthest=40.0),
    "two of 32": Lidar(32, -25.0, 15.0, 1400, 200.0, ((0.0, 0.0, 0.0), (0.0, 0.0, -0.07))),
    "two of 16, apart": Lidar(16, -15.0, 15.0, 1800, 100.0, ((0.0, 0.7, 0.0), (0.0, -0.7, 0.0))),
    "solid state": Lidar(0, -12.5, 35.0, 24_000, farthest=250.0),
    "64, moving": Lidar(64, -24.8, 2.0, 1900, speed=15.0),
}


def scan(rng: Rng, renderer: QuickRenderer, settings: DomainSettings, kind: str | None = None) -> tuple[Array, Array]:
    """Points [N, 3] metres, ring by ring, and the instance [N] that each lies on; noisy, with dropouts.

    `kind`: of :data:`LIDARS`; None: what the settings drew.
    """
    lidar = LIDARS[kind or str(settings.beams)]
    points, labels = zip(*(_scan(rng, renderer, settings, lidar, place) for place in lidar.places), strict=True)
    return np.concatenate(points), np.concatenate(labels)


def _scan(
    rng: Rng, renderer: QuickRenderer, settings: DomainSettings, lidar: Lidar, place: tuple[float, float, float]
) -> tuple[Array, Array]:
    ray, time = _rings(rng, lidar) if lidar.beams else _rosette(rng, lidar)
    start = np.asarray(place) + lidar.speed * time[:, None] * np.array([1.0, 0.0, 0.0])
    labels, distance, facing, absorbs = renderer.cast(np.concatenate([start, ray], axis=1).astype(np.float32))
    labels, distance = _mixed(rng, labels, distance, max(1, lidar.beams))
    seen = (labels >= 0) & (distance > _NEAREST) & (distance < lidar.farthest)
    lost = 0.02 + 0.6 * settings.holes * absorbs
    far = np.where(np.isfinite(distance), distance, 0.0) / lidar.farthest
    lost = lost + settings.holes * (0.25 * far**2 + 0.5 * far * (facing < 0.06))
    seen &= rng.random(len(ray)) > lost
    measured = distance[seen].astype(np.float64) + settings.depth_noise * rng.standard_normal(int(seen.sum()))
    measured = np.round(measured / 0.002) * 0.002
    return (np.asarray(place) + ray[seen] * measured[:, None]).astype(np.float32), labels[seen]


def _rings(rng: Rng, lidar: Lidar) -> tuple[Array, Array]:
    """Directions [R, 3] of a turn, ring by ring, and the time [R] of each, seconds."""
    elevation = np.radians(np.linspace(lidar.low, lidar.high, lidar.beams) + rng.normal(0, 0.03, lidar.beams))
    azimuth = 2 * np.pi * (np.arange(lidar.steps) + rng.random()) / lidar.steps
    azimuth = azimuth[None] + rng.uniform(0, 2 * np.pi / lidar.steps, (lidar.beams, 1))
    return _directions(elevation[:, None] + 0 * azimuth, azimuth), (azimuth / (2 * np.pi) * _TURN).reshape(-1)


def _rosette(rng: Rng, lidar: Lidar) -> tuple[Array, Array]:
    """The same of two prisms that turn against each other: petals, which differ from scan to scan."""
    time = np.arange(lidar.steps) / lidar.steps
    petal, turn = 2 * np.pi * (rng.random() + 33.7 * time), 2 * np.pi * (rng.random() + 5.3 * time)
    azimuth = np.radians(lidar.high) * np.cos(petal) * np.cos(turn)
    elevation = np.radians(lidar.low) * np.cos(petal) * np.sin(turn)
    return _directions(elevation, azimuth), time * _TURN


def _directions(elevation: Array, azimuth: Array) -> Array:
    flat = np.cos(elevation)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=-1).reshape(-1, 3)


def _mixed(rng: Rng, labels: Array, distance: Array, beams: int) -> tuple[Array, Array]:
    """Some beams on an edge return a range between those of its two sides."""
    near, label = distance.reshape(beams, -1), labels.reshape(beams, -1)
    other = np.roll(near, 1, axis=1)
    both = np.isfinite(near) & np.isfinite(other)
    gap = np.abs(np.where(both, near, 0) - np.where(both, other, 0))
    mixes = both & (gap > 0.3) & (gap < 3.0) & (rng.random(near.shape) < 0.08)
    share = rng.random(near.shape)
    between = np.where(mixes, (1 - share) * np.where(both, near, 0) + share * np.where(both, other, 0), near)
    label = np.where(mixes & (share > 0.5), np.roll(label, 1, axis=1), label)
    return label.reshape(-1), between.reshape(-1)
