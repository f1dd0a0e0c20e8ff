"""Slender objects that visually split the object behind them: each function returns one instance."""

from __future__ import annotations

import numpy as np

from torchjoint_lab.synthetic.furnished import materials as paint
from torchjoint_lab.synthetic.furnished.arrays import Rng
from torchjoint_lab.synthetic.furnished.materials import Material
from torchjoint_lab.synthetic.furnished.mesh import ball, box, cup, cylinder, tube
from torchjoint_lab.synthetic.furnished.world import Item


def pillar(rng: Rng, height: float) -> Item:
    """A post from floor to ceiling (``height`` metres), round or square, 4-12 cm thick."""
    r = float(rng.uniform(0.02, 0.06))
    post = cylinder(r, height) if rng.random() < 0.5 else box((2 * r, 2 * r, height))
    return Item("pillar", (2 * r, 2 * r, height), [(post, _coat(rng))])


def rail(rng: Rng, length: float) -> Item:
    """A board along a wall, ``length`` metres, 2-4 cm deep, 7-14 cm tall: for example a handrail or cable duct."""
    d, h = rng.uniform(0.02, 0.04), rng.uniform(0.07, 0.14)
    return Item("rail", (length, d, h), [(box((length, d, h)), _coat(rng))])


def coat_stand(rng: Rng) -> Item:
    """A pole on a round foot, with hooks at two heights."""
    h, r = rng.uniform(1.55, 1.85), rng.uniform(0.016, 0.028)
    coat = _coat(rng)
    parts = [(cylinder(0.17, 0.03), coat), (cylinder(r, h - 0.03, (0, 0, 0.03), segments=12), coat)]
    parts.append((ball(1.4 * r, (0, 0, h - 1.4 * r)), coat))
    for i, turn in enumerate(np.arange(6) * np.pi / 3 + rng.uniform(0, np.pi)):
        z = h - (0.1 if i % 2 else 0.28)
        reach = np.array([r, 0.07, 0.12])
        hook = np.stack([reach * np.cos(turn), reach * np.sin(turn), z + np.array([0.0, 0.0, 0.05])], axis=1)
        parts.append((tube(hook, 0.008), coat))
    return Item("coat stand", (0.34, 0.34, h + 1.4 * r), parts)


def plant(rng: Rng) -> Item:
    """A small tree in a pot: a bare stem and a crown of a few round clumps."""
    h, r = rng.uniform(1.1, 1.6), rng.uniform(0.13, 0.17)
    clay = paint.plain(rng, paint.pick(rng, ((0.62, 0.35, 0.24), *paint.SOBER)))
    earth = paint.speckle(rng, np.array([0.2, 0.14, 0.1]), gloss=0.0)
    bark = paint.plain(rng, np.array([0.35, 0.25, 0.17]), gloss=0.0)
    green = paint.speckle(rng, np.array([0.16, 0.34, 0.14]) * rng.uniform(0.8, 1.4), contrast=0.35, gloss=0.0)
    parts = [(cup(r, 0.28, 0.012, flare=1.3), clay), (cylinder(0.75 * r, 0.02, (0, 0, 0.2)), earth)]
    parts.append((cylinder(rng.uniform(0.01, 0.018), h - 0.3, (0, 0, 0.2), segments=10), bark))
    for _ in range(7):
        size = float(rng.uniform(0.06, 0.1))
        x, y = rng.uniform(-0.09, 0.09, 2)
        parts.append((ball(size, (x, y, h - 0.25 + rng.uniform(-0.1, 0.1))), green))
    return Item("plant", (0.38, 0.38, h + 0.05), parts)


def clothes_rail(rng: Rng) -> Item:
    """An empty frame of two posts and two cross bars; the camera sees through it."""
    w, h, t = rng.uniform(0.8, 1.3), rng.uniform(1.2, 1.6), rng.uniform(0.025, 0.04)
    coat = _coat(rng)
    parts = [(box((w, t, t), (0, 0, z)), coat) for z in (h - t, rng.uniform(0.25, 0.7))]
    for x in (-1, 1):
        parts.append((box((t, t, h - t), (x * (w - t) / 2, 0, 0)), coat))
        parts.append((box((t, 0.36, t), (x * (w - t) / 2, 0, 0)), coat))
    return Item("clothes rail", (w, 0.36, h), parts)


def _coat(rng: Rng) -> Material:
    if rng.random() < 0.4:
        return paint.wood(rng, paint.pick(rng, paint.WOODS), upright=True)
    return paint.plain(rng, paint.pick(rng, paint.SOBER + paint.WALLS + paint.VIVID), gloss=0.3)
