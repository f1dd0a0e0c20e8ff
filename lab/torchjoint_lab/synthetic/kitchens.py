"""Kitchens: counters and cupboards along two walls, a table with chairs, dishes, packets, magazines."""

from __future__ import annotations

import numpy as np

from torchjoint_lab.synthetic import household, making, office, prints
from torchjoint_lab.synthetic.furnished import furniture
from torchjoint_lab.synthetic.furnished.arrays import Array
from torchjoint_lab.synthetic.furnished.materials import Material
from torchjoint_lab.synthetic.furnished.mesh import box
from torchjoint_lab.synthetic.furnished.world import Item
from torchjoint_lab.synthetic.rigs import Rig
from torchjoint_lab.synthetic.settings import DomainSettings
from torchjoint_lab.synthetic.source import Source
from torchjoint_lab.synthetic.stage import Stage
from torchjoint_lab.synthetic.support import Support
from torchjoint_lab.synthetic.tabletop import Layout, arrange, lamps, spread_cloth, table

#: What stands on kitchen tables and counters.
DISHES = (
    (household.mug, 2.5),
    (household.bowl, 1.5),
    (household.plate, 1.5),
    (household.pan, 1.2),
    (household.teapot, 0.8),
    (household.vessel, 2.0),
    (household.packet, 2.5),
    (household.tin, 1.2),
    (household.fruit, 1.2),
    (household.basket, 0.8),
    (household.cutlery, 1.0),
    (household.bag, 0.8),
    (household.plant, 0.4),
    (household.book, 0.6),
    (office.speaker, 0.4),
)


def build(source: Source, settings: DomainSettings) -> Layout:
    """A kitchen, seen from its middle and over its table."""
    rng, stage = source.rng, Stage()
    w, d = source.between(3.0, 4.2), source.between(3.0, 4.0)
    _shell(source, stage, w, d)
    front = source.style.body(0.2) if source.chance(0.6) else source.style.wood(upright=True)
    height, depth = source.between(0.82, 0.95), source.between(0.5, 0.62)
    _counters(source, stage, w, d, front, height, depth)
    middle = rng.uniform(-0.3, 0.1, 2)
    top = _table_group(source, stage, middle)
    floor = Support(rng, stage, (-w / 2 + 0.8, -d / 2 + 0.2), (w / 2 - 0.2, d / 2 - 0.8), 0.0, cell=0.012)
    for _ in range(int(rng.integers(0, 4))):
        side = np.array([w / 2 - 0.3, -d / 2 + 0.4]) * rng.uniform(0.7, 0.95, 2)
        floor.fixed(source.thing(0.6), side[0], side[1], float(rng.uniform(-3, 3)))
    rig = Rig(
        (*middle, top),
        (0.5, 0.5, 0.2),
        (1.1, 1.9),
        (np.radians(18), np.radians(50)),
        float(rng.uniform(-np.pi, np.pi)),
        float(np.radians(rng.uniform(50, 175))),
        low=(-w / 2 + depth + 0.15, -d / 2 + 0.15, 1.0),
        high=(w / 2 - 0.15, d / 2 - depth - 0.15, 2.0),
    )
    world = stage.build(*lamps(rng, (0, 0, 1.0), 1.3))
    crop = np.array([middle[0] - 1.1, middle[1] - 1.1, -0.1]), np.array([middle[0] + 1.1, middle[1] + 1.1, 1.6])
    return Layout(world, rig, crop)


def _shell(source: Source, stage: Stage, w: float, d: float) -> None:
    """Floor and four walls; a rug now and then."""
    style = source.style
    stage.add(Item("floor", (w, d, 0.1), [(box((w, d, 0.1), (0, 0, -0.1)), style.floor())]))
    paint = style.wall()
    for x in (-1, 1):
        coat = paint if source.chance(0.7) else style.wall()
        stage.add(Item("wall", (0.1, d, 2.6), [(box((0.1, d, 2.6), (x * (w / 2 + 0.05), 0, 0)), coat)]))
        stage.add(Item("wall", (w, 0.1, 2.6), [(box((w, 0.1, 2.6), (0, x * (d / 2 + 0.05), 0)), paint)]))


def _counters(source: Source, stage: Stage, w: float, d: float, front: Material, height: float, depth: float) -> None:
    """Cabinets along the walls y = d/2 and x = -w/2, things on them, cupboards above."""
    rng = source.rng
    for length, yaw in ((w - depth - 0.05, 0.0), (d, np.pi / 2)):
        along = -length / 2
        while along < length / 2 - 0.4:
            width = min(float(rng.uniform(0.4, 1.4)), length / 2 - along)
            middle = along + width / 2 + ((depth + 0.05) / 2 if yaw == 0 else 0.0)
            x, y = (middle, d / 2 - depth / 2) if yaw == 0 else (-w / 2 + depth / 2, middle)
            along += width + (0.0 if source.chance(0.8) else 0.3)
            if source.chance(0.12):
                tall = source.model(("fridge", "high cabinet"), 1.0, 2.3)
                item = tall or furniture.cabinet(rng, front, width, 2.0, depth)
                stage.stand(item, x, y, 0.0, yaw)
                continue
            stage.stand(furniture.cabinet(rng, front, width, height, depth), x, y, 0.0, yaw)
            half = np.array([width, depth] if yaw == 0 else [depth, width]) / 2 - 0.01
            board = Support(rng, stage, (x - half[0], y - half[1]), (x + half[0], y + half[1]), height, cell=0.006)
            for _ in range(source.count(1, 4)):
                item = source.thing(0.4, DISHES)
                board.stand(item) if source.chance(0.6) else board.beside(item) or board.stand(item, stacked=0.5)
            if source.chance(0.45):
                out = -0.15 if yaw == 0 else 0.15
                at = (x, y - out) if yaw == 0 else (x - out, y)
                stage.stand(furniture.cabinet(rng, front, width, 0.65, 0.3), *at, height + 0.5, yaw)


def _table_group(source: Source, stage: Stage, middle: Array) -> float:
    """A table, laid or littered, and its chairs; returns the table's height."""
    rng, style = source.rng, source.style
    w, d, h = source.between(0.8, 1.5), source.between(0.7, 0.95), source.between(0.7, 0.77)
    x, y = (float(v) for v in middle)
    if source.chance(0.35):
        rug = making.made("rug", [(box((w + 0.7, d + 0.7, 0.008)), style.cloth())])
        stage.stand(rug, x, y, 0.0005)
    stage.stand(table(source, w, d, h), x, y, 0.009)
    half = np.array([w, d]) / 2
    top = Support(rng, stage, tuple(middle - half), tuple(middle + half), h + 0.009, cell=0.005)
    if source.chance(0.25):
        spread_cloth(source, top, half)
    for _ in range(int(rng.integers(0, 4))):  # magazines, newspapers, letters
        size = tuple(rng.uniform([0.15, 0.2], [0.23, 0.31]))
        page = prints.package(rng, size) if source.chance(0.6) else prints.text_page(rng, size)
        top.stand(making.made("magazine", [(box((*size, rng.uniform(0.002, 0.008))), page)]))
    for _ in range(source.count(4, 12)):
        item = source.thing(0.36, DISHES)
        top.stand(item, stacked=0.25) or top.beside(item)
    arrange(source, top, 2, 0.3)
    frame, seat, slats = style.wood(), style.cloth() if source.chance(0.5) else style.wood(), int(rng.integers(2, 5))
    for side in rng.permutation(4)[: rng.integers(1, 5)]:
        yaw = (0.0, np.pi / 2, np.pi, -np.pi / 2)[side]
        reach = (half[1] if side % 2 == 0 else half[0]) + rng.uniform(-0.1, 0.35)
        chair = source.model(("chair",), 0.6, 1.1) or furniture.chair(rng, frame, seat, slats)
        turn = float(yaw + rng.normal(0, 0.15))
        stage.stand(chair, x - np.sin(yaw) * reach, y + np.cos(yaw) * reach, 0.009, turn)
    return h
