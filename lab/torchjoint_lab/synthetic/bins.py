"""Bins: an open box with a heap of things in it, seen from above."""

from __future__ import annotations

import numpy as np

from torchjoint_lab.synthetic import household, making
from torchjoint_lab.synthetic.furnished.mesh import box
from torchjoint_lab.synthetic.furnished.world import Item
from torchjoint_lab.synthetic.rigs import Rig
from torchjoint_lab.synthetic.settings import DomainSettings
from torchjoint_lab.synthetic.source import Source
from torchjoint_lab.synthetic.stage import Stage
from torchjoint_lab.synthetic.support import Support
from torchjoint_lab.synthetic.tabletop import Layout, backdrop, lamps, table
from torchjoint_lab.synthetic.tools import TOOLS


def build(source: Source, settings: DomainSettings) -> Layout:
    """A bin with 3 to 30 things, all sorts or many of one kind; some lie beside it."""
    rng, stage = source.rng, Stage()
    w, d, h = source.between(0.25, 0.65), source.between(0.22, 0.45), source.between(0.06, 0.32)
    z = 0.0
    backdrop(source, stage, 2.5, None)
    if source.chance(0.5):
        z = source.between(0.4, 0.8)
        stage.add(table(source, w + source.between(0.2, 0.9), d + source.between(0.2, 0.6), z))
    t = source.between(0.003, 0.015)
    outside = Support(rng, stage, (-w / 2 - 0.25, -d / 2 - 0.2), (w / 2 + 0.25, d / 2 + 0.2), z, cell=0.005)
    outside.fixed(crate(source, w, d, h, t), 0, 0)
    inside = Support(rng, stage, (-w / 2 + t, -d / 2 + t), (w / 2 - t, d / 2 - t), z + t, cell=0.004)
    most = 0.75 * min(w, d)
    things = TOOLS if source.chance(0.2) else household.THINGS
    kinds = [source.thing(most, things) for _ in range(int(rng.integers(1, 6)))]
    sorted_bin = source.chance(0.35)
    for _ in range(source.count(8, 22)):
        item = kinds[rng.integers(len(kinds))] if sorted_bin else source.thing(most, things)
        if source.chance(0.2):
            inside.stand(item, stacked=0.5) or inside.drop(item)
        else:
            inside.drop(item, spread=0.8)
    for _ in range(int(rng.integers(0, 4))):
        outside.stand(source.thing(0.2))
    reach = max(w, d)
    rig = Rig(
        (0, 0, z + h / 3),
        (0.03, 0.03, 0.02),
        (0.6 + 0.5 * reach, 0.8 + 1.0 * reach),
        (np.radians(50), np.radians(88)),
        -np.pi / 2 + rng.normal(0, 0.3),
        float(np.radians(rng.uniform(10, 170))),
    )
    world = stage.build(*lamps(rng, (0, 0, z), 1.6))
    margin = float(rng.choice([0.02, 0.15]))
    low = np.array([-w / 2 - margin, -d / 2 - margin, z - 0.02])
    return Layout(world, rig, (low, np.array([w / 2 + margin, d / 2 + margin, z + h + 0.4])))


def crate(source: Source, w: float, d: float, h: float, t: float) -> Item:
    """The bin: closed or slatted walls, ``t`` metres thick."""
    style, rng = source.style, source.rng
    coat = style.package((w, h)) if source.chance(0.25) else style.wood() if source.chance(0.3) else style.body(0.1)
    parts = [(box((w, d, t)), coat)]
    rows = int(rng.choice([1, 1, 3]))
    gap = 0.0 if rows == 1 else 0.2 * h / rows
    for row in range(rows):
        z, high = row * h / rows, h / rows - gap
        parts += [(box((t, d, high), (x * (w - t) / 2, 0, z)), coat) for x in (-1, 1)]
        parts += [(box((w, t, high), (0, y * (d - t) / 2, z)), coat) for y in (-1, 1)]
    if rows > 1:
        parts += [(box((2 * t, 2 * t, h), (x * (w / 2 - t), y * (d / 2 - t))), coat) for x in (-1, 1) for y in (-1, 1)]
    return making.made("crate", parts, hollow=True)
