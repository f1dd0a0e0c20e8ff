"""One turn of a LiDAR at the origin."""

from __future__ import annotations

import numpy as np

from torchjoint.synthetic.arrays import Array, Rng
from torchjoint_lab.synthetic.quick_render import QuickRenderer
from torchjoint_lab.synthetic.settings import DomainSettings

#: Nearest and farthest range that is returned, metres.
_RANGE = (1.8, 80.0)
#: Elevations of the lowest and highest beam, degrees, and steps of a turn, by the number of beams.
_BEAMS = {16: (-15.0, 15.0, 1800), 32: (-30.0, 10.0, 1400), 64: (-24.8, 2.0, 1900)}


def turn(rng: Rng, renderer: QuickRenderer, settings: DomainSettings) -> tuple[Array, Array]:
    """Points [N, 3] metres, ring by ring, and the instance [N] that each lies on; noisy, with dropouts."""
    lowest, highest, steps = _BEAMS[settings.beams]
    elevation = np.radians(np.linspace(lowest, highest, settings.beams) + rng.normal(0, 0.03, settings.beams))
    azimuth = 2 * np.pi * (np.arange(steps) + rng.random()) / steps
    azimuth = azimuth[None] + rng.uniform(0, 2 * np.pi / steps, (settings.beams, 1))
    flat = np.cos(elevation)[:, None]
    ray = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)[:, None] + 0 * azimuth], axis=-1)
    ray = ray.reshape(-1, 3)
    rays = np.concatenate([np.zeros_like(ray), ray], axis=1).astype(np.float32)
    labels, distance, facing, absorbs = renderer.cast(rays)
    labels, distance = _mixed(rng, labels, distance, settings.beams)
    seen = (labels >= 0) & (distance > _RANGE[0]) & (distance < _RANGE[1])
    lost = 0.02 + 0.6 * settings.holes * absorbs
    far = np.where(np.isfinite(distance), distance, 0.0) / _RANGE[1]
    lost = lost + settings.holes * (0.25 * far**2 + 0.5 * far * (facing < 0.06))
    seen &= rng.random(len(ray)) > lost
    measured = distance[seen].astype(np.float64) + settings.depth_noise * rng.standard_normal(int(seen.sum()))
    measured = np.round(measured / 0.002) * 0.002
    return (ray[seen] * measured[:, None]).astype(np.float32), labels[seen]


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
