"""Shelves: boards on which things stand close together, books in rows, some of them leaning, boxes, heaps."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from torchjoint_lab.synthetic import making
from torchjoint_lab.synthetic.furnished.arrays import Array, Rng
from torchjoint_lab.synthetic.furnished.mesh import box
from torchjoint_lab.synthetic.furnished.world import Item
from torchjoint_lab.synthetic.rigs import Rig
from torchjoint_lab.synthetic.settings import DomainSettings
from torchjoint_lab.synthetic.solids import euler, rotated
from torchjoint_lab.synthetic.source import Source
from torchjoint_lab.synthetic.stage import Body, Stage
from torchjoint_lab.synthetic.style import Style
from torchjoint_lab.synthetic.support import Support
from torchjoint_lab.synthetic.tabletop import Layout, arrange, backdrop, lamps


def build(source: Source, settings: DomainSettings) -> Layout:
    """A shelf of 1 to 4 boards before a wall, seen from in front."""
    rng, stage = source.rng, Stage()
    boards = int(rng.integers(1, 5))
    w, d = source.between(0.5, 1.3), source.between(0.2, 0.42)
    rooms = rng.uniform(0.22, 0.42, boards)
    foot = source.between(0.05, 0.9) if boards < 3 else source.between(0.05, 0.3)
    backdrop(source, stage, 3.0, d / 2 + 0.02)
    levels = foot + np.concatenate([[0.0], np.cumsum(rooms)])
    stage.add(case(source, w, d, levels))
    for z, room in zip(levels[:-1], rooms, strict=True):
        low, high = (-w / 2 + 0.02, -d / 2), (w / 2 - 0.02, d / 2 - 0.015)
        fill(source, Support(rng, stage, low, high, z + 0.02, cell=0.004, headroom=room - 0.03))
    if source.chance(0.6):
        top = Support(rng, stage, (-w / 2, -d / 2), (w / 2, d / 2 - 0.01), levels[-1] + 0.02, cell=0.004)
        arrange(source, top, source.count(1, 5), 0.3)
    height = float(levels[-1] - foot)
    middle = (0.0, 0.0, float(foot + levels[-1]) / 2)
    rig = Rig(
        middle,
        (0.1, 0.03, 0.12 * height),
        (0.7 + 0.3 * height, 1.1 + 0.7 * height),
        (np.radians(-8), np.radians(35)),
        -np.pi / 2 + rng.normal(0, 0.15),
        float(np.radians(rng.uniform(8, 50))),
        low=(-5, -5, 0.15),
        high=(5, -d / 2 - 0.2, 2.2),
    )
    world = stage.build(*lamps(rng, (0, -1.0, middle[2]), 1.6))
    crop = np.array([-w / 2 - 0.05, -d / 2 - 0.1, foot - 0.05]), np.array([w / 2 + 0.05, d / 2 + 0.1, levels[-1] + 0.5])
    return Layout(world, rig, crop)


def case(source: Source, w: float, d: float, levels: Array) -> Item:
    """The shelf itself: boards at ``levels``, sides, a back; or boards between thin posts."""
    coat = source.style.wood() if source.chance(0.5) else source.style.body(0.1)
    height = float(levels[-1]) + 0.02
    parts = [(box((w, d, 0.02), (0, 0, z)), coat) for z in levels]
    if source.chance(0.7):
        parts += [(box((0.018, d, height - levels[0]), (x * (w / 2 - 0.009), 0, levels[0])), coat) for x in (-1, 1)]
    else:
        metal = source.style.metal()
        for x in (-1, 1):
            parts += [(box((0.025, 0.025, height), (x * w / 2, y * (d / 2 - 0.02))), metal) for y in (-1, 1)]
    if source.chance(0.6):
        parts.append((box((w, 0.01, height - levels[0]), (0, d / 2, levels[0])), coat))
    return making.made("shelf", parts, hollow=True)


def fill(source: Source, board: Support) -> None:
    """Fills one board: a row of books, things side by side in a row, or things anyhow."""
    way = source.rng.random()
    if way < 0.4:
        row(source, board, lambda: upright_book(source.rng, source.style, board.headroom))
    elif way < 0.75:
        row(source, board, lambda: source.thing(min(board.headroom, 0.35)))
    else:
        arrange(source, board, source.count(4, 9), min(board.headroom, 0.35))


def row(source: Source, board: Support, draw: Callable[[], Item]) -> None:
    """Pushes things together from the left to the right, some of them leaning on the one before."""
    rng, heights = source.rng, board.heights
    depth = float(heights.high[1] - heights.low[1])
    front, gap = float(heights.low[1] + rng.uniform(0.05, 0.3) * depth), float(rng.choice([0, 0, 0.02]))
    width, failures, leans = float(heights.high[0] - heights.low[0]), 0, rng.uniform(0, 0.25)
    while failures < 6 and not source.chance(0.04):
        item = draw()
        tilt = float(np.radians(rng.uniform(5, 22))) if rng.random() < leans else 0.0
        yaw = float(rng.choice([0, 0, np.pi / 2])) if item.name != "book" else 0.0
        turn = euler(yaw + rng.normal(0, 0.03)) @ euler(0, 0, -tilt)
        body = Body.of(rng, item, heights.cell)
        points = rotated(body.coarse() - body.centre, turn)
        half = np.ptp(points, axis=0) / 2
        y = front - points[:, 1].min() + abs(rng.normal(0, 0.008))
        start = np.array([heights.high[0] + points[:, 0].min() - 0.004 - gap, y])
        spot = board.pushed(body, turn, start, np.array([-1.0, 0.0]), width, to_edge=True)
        if spot is None or 2 * half[0] > width or not board.lay(body, turn, spot):
            failures += 1
            continue
        if source.chance(0.05):  # a gap
            failures += int(rng.integers(0, 3))


def upright_book(rng: Rng, style: Style, headroom: float) -> Item:
    """A book standing, its spine to the front (-y)."""
    height, depth = rng.uniform(0.6, 0.97) * min(headroom, 0.33), rng.uniform(0.1, 0.2)
    t = float(np.clip(making.log_uniform(rng, 0.008, 0.06), 0.008, 0.06))
    cover = style.package((t, height))
    side = cover if rng.random() < 0.5 else style.package((depth, height))
    pages = style.body(0.0)
    parts = [(box((t, 0.002, height), (0, -depth / 2 + 0.001, 0)), cover)]
    parts += [(box((0.002, depth - 0.002, height), (x * (t / 2 - 0.001), 0.001, 0)), side) for x in (-1, 1)]
    return making.made("book", [*parts, (box((t - 0.004, depth - 0.006, height - 0.006), (0, 0, 0.003)), pages)])
