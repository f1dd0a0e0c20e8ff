"""Desks: a monitor, a keyboard, papers, cables, mugs, boxes, before a wall."""

from __future__ import annotations

import numpy as np

from torchjoint_lab.synthetic import making, office, prints
from torchjoint_lab.synthetic.furnished.arrays import Array
from torchjoint_lab.synthetic.furnished.materials import Material
from torchjoint_lab.synthetic.furnished.mesh import Part, box
from torchjoint_lab.synthetic.rigs import Rig
from torchjoint_lab.synthetic.settings import DomainSettings
from torchjoint_lab.synthetic.shelves import row
from torchjoint_lab.synthetic.source import Source
from torchjoint_lab.synthetic.stage import Stage
from torchjoint_lab.synthetic.support import Support
from torchjoint_lab.synthetic.tabletop import Layout, backdrop, lamps, table


def build(source: Source, settings: DomainSettings) -> Layout:
    """A desk as somebody left it."""
    rng, stage = source.rng, Stage()
    w, d, h = source.between(1.0, 1.7), source.between(0.6, 0.85), source.between(0.7, 0.78)
    wall = d / 2 + source.between(0.02, 0.3)
    backdrop(source, stage, 2.5, wall)
    stage.add(table(source, w, d, h))
    half = np.array([w, d]) / 2
    top = Support(rng, stage, tuple(-half), tuple(half), h, cell=0.004)
    _workplace(source, top, half)
    if source.chance(0.35):  # binders or books along the wall
        end = Support(rng, stage, (half[0] - 0.45, half[1] - 0.3), (half[0], half[1]), h, cell=0.004)
        end.heights.share(top.heights)
        row(source, end, lambda: office.binder(rng, source.style))
        top.heights.share(end.heights)
    for _ in range(source.count(6, 18)):
        item = source.thing(0.4, office.SMALL)
        way = rng.random()
        if way < 0.45:
            top.stand(item)
        elif way < 0.65:
            top.beside(item) or top.stand(item)
        elif way < 0.85:
            top.stand(item, stacked=1.0) or top.stand(item)
        else:
            top.drop(item)
    _sheets(source, top)
    for _ in range(int(rng.integers(0, 4))):
        path = path_over(source, top)
        if np.ptp(path[:, 2]) < 0.15:  # not up a monitor
            stage.add(office.cable(rng, source.style, path))
    _chair(source, stage, d)
    rig = Rig(
        (0, 0, h + 0.1),
        (0.15, 0.08, 0.05),
        (0.8, 1.5),
        (np.radians(15), np.radians(60)),
        -np.pi / 2 + rng.normal(0, 0.2),
        float(np.radians(rng.uniform(20, 65))),
        high=(3.0, wall - 0.1, 2.4),
    )
    world = stage.build(*lamps(rng, (0, -0.4, h), 1.6))
    crop = np.array([*(-half - 0.1), h - 0.1]), np.array([*(half + 0.1), h + 0.8])
    return Layout(world, rig, crop)


def _workplace(source: Source, top: Support, half: Array) -> None:
    """A mat, a monitor or two, a keyboard, a mouse, in their usual places."""
    rng, style = source.rng, source.style
    x = float(rng.normal(0, 0.15))
    if source.chance(0.3):
        mat = making.made("mat", [(box((rng.uniform(0.4, 0.8), 0.35, 0.003)), style.cloth())])
        top.fixed(mat, x, -half[1] + 0.24)
    for side in (0.0,) if source.chance(0.7) else (-0.3, 0.3):
        screen = source.model(("imac", "tv 16", "screen"), 0.3, 0.7) or office.monitor(rng, style)
        top.fixed(screen, x + side, half[1] - 0.17, float(rng.normal(-side, 0.12)))
    if source.chance(0.85):
        top.fixed(office.keyboard(rng, style), x + rng.normal(0, 0.04), -half[1] + 0.2, float(rng.normal(0, 0.1)))
    if source.chance(0.8):
        top.fixed(office.mouse(rng, style), x + 0.32, -half[1] + 0.2, float(rng.normal(0, 0.3)))


def _sheets(source: Source, top: Support) -> None:
    """A few sheets of paper, some on others."""
    rng = source.rng
    for _ in range(int(rng.integers(0, 4))):
        size = (0.21, 0.297) if source.chance(0.7) else (0.105, 0.148)
        sheet = making.made("paper", [(box((*size, 0.001)), prints.text_page(rng, size))])
        top.stand(sheet, stacked=0.3)


def path_over(source: Source, top: Support) -> Array:
    """[P, 3] a smooth path over what lies there."""
    rng, heights = source.rng, top.heights
    low, high = heights.low + 0.05, heights.high - 0.05
    knots = rng.uniform(low, high, (4, 2))
    knots[1:] = np.clip(knots[0] + np.cumsum(rng.normal(0, 0.18, (3, 2)), axis=0), low, high)
    t, step = np.linspace(0, 3, 60), np.arange(4)
    place = np.stack([np.interp(t, step, knots[:, i]) for i in (0, 1)], axis=1)
    kernel = np.ones(13) / 13
    padded = np.pad(place, [(6, 6), (0, 0)], mode="edge")
    place = np.stack([np.convolve(padded[:, i], kernel, "valid") for i in (0, 1)], axis=1)
    # So high as to clear what is below and beside, then smoothed like the rest.
    around = [place + shift for shift in np.array([[0, 0], [0.006, 0], [-0.006, 0], [0, 0.006], [0, -0.006]])]
    height = np.max([heights.at(spot) for spot in around], axis=0)
    ceiling = np.max([np.pad(height, 4, mode="edge")[i : i + 60] for i in range(9)], axis=0)
    ceiling = np.convolve(np.pad(ceiling, 4, mode="edge"), np.ones(9) / 9, "valid")
    return np.concatenate([place, np.maximum(ceiling, height)[:, None]], axis=1)


def _chair(source: Source, stage: Stage, depth: float) -> None:
    """A chair drawn up to the desk, now and then."""
    if not source.chance(0.4):
        return
    coat, seat = source.style.body(0.2), source.style.cloth()
    rng = source.rng
    back = making.made("chair", chair_parts(coat, seat, rng.uniform(0.4, 0.5), rng.uniform(0.75, 1.0)))
    stage.stand(
        back, float(rng.normal(0, 0.2)), -depth / 2 - rng.uniform(0.1, 0.4), 0.0, float(np.pi + rng.normal(0, 0.4))
    )


def chair_parts(frame: Material, seat: Material, h: float, back: float) -> list[tuple[Part, Material]]:
    """Seat, legs and back (at +y) of a simple chair."""
    parts = [
        (box((0.43, 0.43, 0.05), (0, 0, h - 0.05)), seat),
        (box((0.42, 0.03, 0.4 * back), (0, 0.2, 0.6 * back)), seat),
    ]
    for x in (-0.19, 0.19):
        parts += [
            (box((0.035, 0.035, h - 0.05), (x, -0.19)), frame),
            (box((0.035, 0.035, 0.95 * back), (x, 0.19)), frame),
        ]
    return parts
