"""Table-tops: household things that stand, touch, pile and lean on one table."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from torchjoint_lab.synthetic import making, prints
from torchjoint_lab.synthetic.furnished.arrays import Array, Rng
from torchjoint_lab.synthetic.furnished.mesh import Part, box, cylinder
from torchjoint_lab.synthetic.furnished.world import Item, Light, World
from torchjoint_lab.synthetic.rigs import Cameras, Rig
from torchjoint_lab.synthetic.settings import DomainSettings
from torchjoint_lab.synthetic.solids import rounded_box
from torchjoint_lab.synthetic.source import Source
from torchjoint_lab.synthetic.stage import Stage
from torchjoint_lab.synthetic.support import Support


class Layout(NamedTuple):
    """A furnished world.

    Attributes:
        world: its things and lamps.
        rig: where cameras go.
        crop: [3] least and [3] greatest x, y, z of a cloud that holds only what matters.
    """

    world: World
    rig: Cameras
    crop: tuple[Array, Array]


def lamps(rng: Rng, centre: tuple[float, float, float], reach: float) -> tuple[tuple[Light, ...], float]:
    """One or two lamps or windows around a place, and the ambient light."""
    count, lights = int(rng.integers(1, 3)), []
    for _ in range(count):
        turn, away = rng.uniform(-np.pi, np.pi), reach * rng.uniform(0.4, 1.5)
        place = np.array([away * np.cos(turn), away * np.sin(turn), reach * rng.uniform(0.8, 1.8)]) + centre
        warmth = rng.uniform(-0.15, 0.15)
        power = np.array([1 + warmth, 1, 1 - warmth]) * rng.uniform(0.5, 1.5) * (2 + reach**2) / count
        lights.append(Light(place, float(rng.uniform(0.02, 0.3) * reach), power))
    return tuple(lights), float(rng.uniform(0.15, 0.6))


def backdrop(source: Source, stage: Stage, reach: float, wall: float | None) -> None:
    """A floor ``2 reach`` metres wide and, if given, a wall at y = ``wall``."""
    style = source.style
    stage.add(Item("floor", (1, 1, 0.1), [(box((2 * reach, 2 * reach, 0.1), (0, 0, -0.1)), style.floor())]))
    if wall is not None:
        stage.add(Item("wall", (1, 0.1, 1), [(box((2 * reach, 0.1, 2.6), (0, wall + 0.05, 0)), style.wall())]))


def table(source: Source, w: float, d: float, h: float, round_top: bool = False) -> Item:
    """A table of any kind, its foot at z = 0."""
    rng, style = source.rng, source.style
    top, frame = style.top(), style.wood(upright=True) if rng.random() < 0.5 else style.body()
    t, leg = rng.uniform(0.015, 0.05), rng.uniform(0.02, 0.05)
    board: Part = cylinder(min(w, d) / 2, t, (0, 0, h - t), 48) if round_top else box((w, d, t), (0, 0, h - t))
    parts = [(board, top)]
    if rng.random() < 0.25 or round_top:
        parts.append((cylinder(leg * 1.5, h - t), frame))
        parts.append((cylinder(0.3 * min(w, d), 0.03), frame))
    else:
        for x in (-1, 1):
            for y in (-1, 1):
                parts.append((box((leg, leg, h - t), (x * (w / 2 - leg), y * (d / 2 - leg))), frame))
    return making.made("table", parts)


def build(source: Source, settings: DomainSettings) -> Layout:
    """A table with 2 to 25 things on it."""
    rng, stage = source.rng, Stage()
    w, d, h = source.between(0.6, 1.4), source.between(0.5, 0.9), source.between(0.4, 0.8)
    round_top = source.chance(0.2)
    wall = d / 2 + source.between(0.05, 1.5) if source.chance(0.6) else None
    backdrop(source, stage, 3.0, wall)
    stage.add(table(source, w, d, h, round_top))
    half = np.array([w, d]) / 2 * (0.62 if round_top else 1.0)
    top = Support(rng, stage, tuple(-half), tuple(half), h, cell=0.004)
    if source.chance(0.25):
        spread_cloth(source, top, half)
    arrange(source, top, source.count(3, 14), 0.36)
    rig = Rig(
        (0, 0, h + 0.06),
        (0.06, 0.06, 0.03),
        (0.6, 1.4),
        (np.radians(25), np.radians(65)),
        -np.pi / 2 + rng.normal(0, 0.4),
        float(np.radians(rng.uniform(15, 160))),
        high=(9.0, 9.0 if wall is None else wall - 0.1, 9.0),
    )
    world = stage.build(*lamps(rng, (0, 0, h), 1.5))
    crop = np.array([-w / 2 - 0.1, -d / 2 - 0.1, h - 0.08]), np.array([w / 2 + 0.1, d / 2 + 0.1, h + 0.8])
    return Layout(world, rig, crop)


def spread_cloth(source: Source, top: Support, half: Array) -> None:
    """A cloth or mat on part of a top: flat, patterned."""
    rng = source.rng
    size = rng.uniform(0.5, 1.1, 2) * half
    cloth = making.made("mat", [(rounded_box((*size, rng.uniform(0.002, 0.006)), 0.001), source.style.cloth())])
    x, y = rng.uniform(-0.3, 0.3, 2) * half
    top.fixed(cloth, x, y, float(rng.normal(0, 0.2)))


def arrange(source: Source, top: Support, count: int, most: float) -> None:
    """Puts ``count`` things on a top: free, touching, stacked, lying, leaning; at times several are equal."""
    rng = source.rng
    family = source.thing(most) if source.chance(0.3) else None
    for _ in range(count):
        item = family if family is not None and source.chance(0.4) else source.thing(most)
        way = rng.random()
        if way < 0.3:
            top.stand(item)
        elif way < 0.55:
            top.beside(item) or top.stand(item)
        elif way < 0.72:
            top.stand(item, stacked=1.0) or top.stand(item)
        elif way < 0.82 and max(item.size) > 0.12:
            top.lean(item, source.tilt()) or top.stand(item)
        else:
            top.drop(item, spread=0.7)
    if source.chance(0.12):  # sheets of paper, photographs
        for _ in range(rng.integers(1, 4)):
            w, d = rng.uniform(0.1, 0.3, 2)
            page = prints.text_page(rng, (w, d)) if source.chance(0.6) else prints.photo(rng, (w, d))
            top.stand(making.made("paper", [(box((w, d, 0.0015)), page)]))
