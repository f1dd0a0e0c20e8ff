"""Workshops: tools, pipes, boards and cables on a bench and on the floor around it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from torchjoint_lab.synthetic import household, making, office, tools
from torchjoint_lab.synthetic.desks import path_over
from torchjoint_lab.synthetic.furnished.mesh import box, cylinder
from torchjoint_lab.synthetic.making import Maker
from torchjoint_lab.synthetic.rigs import Rig
from torchjoint_lab.synthetic.settings import DomainSettings
from torchjoint_lab.synthetic.solids import euler
from torchjoint_lab.synthetic.source import Source
from torchjoint_lab.synthetic.stage import Stage
from torchjoint_lab.synthetic.support import Support
from torchjoint_lab.synthetic.tabletop import Layout, backdrop, lamps, table


def build(source: Source, settings: DomainSettings) -> Layout:
    """A bench before a wall with things leaning on it, or a heap on the floor."""
    rng, stage = source.rng, Stage()
    wall = source.between(0.4, 0.7)
    backdrop(source, stage, 3.0, wall)
    bench = source.chance(0.75)
    floor = Support(rng, stage, (-1.3, -1.3), (1.3, wall), 0.0, cell=0.01)
    w, d, h = source.between(0.9, 1.8), source.between(0.45, 0.7), source.between(0.7, 0.95)
    if bench:
        floor.fixed(table(source, w, d, h), 0, wall - d / 2)
        low, high = (-w / 2, wall - d), (w / 2, wall - 0.01)
        top = Support(rng, stage, low, high, h, cell=0.005)
        _heap(source, top, source.count(6, 18), 0.6)
        for _ in range(int(rng.integers(0, 3))):
            stage.add(office.cable(rng, source.style, path_over(source, top)))
        floor.heights.share(top.heights)
    _against_wall(source, floor, w / 2 if bench else 0.0)
    _on_wall(source, stage, wall)
    _heap(source, floor, source.count(3, 9) if bench else source.count(8, 20), 1.2, tools.FLOOR)
    target = (0.0, wall - d / 2, h) if bench and source.chance(0.7) else (0.0, -0.1, 0.3)
    rig = Rig(
        target,
        (0.2, 0.1, 0.1),
        (1.1, 2.2),
        (np.radians(18), np.radians(55)),
        -np.pi / 2 + rng.normal(0, 0.2),
        float(np.radians(rng.uniform(15, 65))),
        high=(3.0, wall - 0.3, 2.4),
    )
    world = stage.build(*lamps(rng, (0, -0.5, 1.0), 1.8))
    crop = np.array([-1.2, -1.2, -0.1]), np.array([1.2, wall + 0.1, 2.0])
    return Layout(world, rig, crop)


def _heap(
    source: Source, support: Support, count: int, most: float, things: Sequence[tuple[Maker, float]] = tools.TOOLS
) -> None:
    """Puts ``count`` things down in every way."""
    rng = source.rng
    for _ in range(count):
        kinds = things if rng.random() < 0.8 else household.THINGS
        item = source.thing(most, kinds)
        way = rng.random()
        if way < 0.3:
            support.stand(item)
        elif way < 0.5:
            support.beside(item) or support.stand(item)
        elif way < 0.65:
            support.stand(item, stacked=1.0) or support.drop(item)
        elif way < 0.75 and max(item.size) > 0.2:
            support.lean(item, source.tilt()) or support.stand(item)
        else:
            support.drop(item)


def _against_wall(source: Source, floor: Support, taken: float) -> None:
    """Boards, ladders and brooms that lean on the wall, ``taken`` metres off its middle or more."""
    rng = source.rng
    wall = float(floor.heights.high[1])
    for _ in range(int(rng.integers(0, 5))):
        make = (tools.ladder, tools.broom, tools.broom, tools.board, tools.pipe)[rng.integers(5)]
        item = make(rng, source.style)
        upright = euler() if item.name in ("ladder", "broom") else euler(0, 0, np.pi / 2)
        tilt = euler(0, -np.radians(rng.uniform(6, 18)))
        floor.lean_on_edge(
            item, tilt @ upright, float(rng.choice([-1, 1]) * rng.uniform(taken + 0.05, max(1.1, taken + 0.3))), wall
        )


def _on_wall(source: Source, stage: Stage, wall: float) -> None:
    """Pipes and ducts along the wall, tools that hang there."""
    rng = source.rng
    for _ in range(int(rng.integers(0, 3))):
        r, x = rng.uniform(0.015, 0.05), rng.uniform(-1.3, 1.3)
        duct = cylinder(r, 2.5) if source.chance(0.6) else box((3 * r, 2 * r, 2.5))
        stage.stand(making.made("pipe", [(duct, source.style.metal())]), float(x), wall - r - 0.001)
    for _ in range(int(rng.integers(0, 6))):
        item = source.of(tools.TOOLS[:6])
        turn = euler(0, np.pi / 2) @ euler(rng.choice([0, np.pi / 2]))
        low = min(float((part.positions @ turn.T)[..., 1].max()) for part, _ in item.parts)
        stage.add(item, turn, (float(rng.uniform(-1, 1)), wall - max(low, 0.02) - 0.002, float(rng.uniform(1.2, 1.8))))
