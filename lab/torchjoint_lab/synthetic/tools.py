"""Tools, parts and containers of a workshop; each function draws one as one instance."""

from __future__ import annotations

import numpy as np

from torchjoint_lab.synthetic import prints
from torchjoint_lab.synthetic.furnished import materials as paint
from torchjoint_lab.synthetic.furnished.arrays import Array, Rng
from torchjoint_lab.synthetic.furnished.mesh import ball, box, cup, cylinder, lathe, tube
from torchjoint_lab.synthetic.furnished.world import Item
from torchjoint_lab.synthetic.household import basket, packet, tin
from torchjoint_lab.synthetic.making import Maker, made
from torchjoint_lab.synthetic.solids import blob, euler, joined, ring, rod, rounded_box, slab, turned
from torchjoint_lab.synthetic.style import Style


def hammer(rng: Rng, style: Style) -> Item:
    """A hammer, mallet or axe, lying."""
    length, r = rng.uniform(0.22, 0.4), rng.uniform(0.011, 0.016)
    head = rng.uniform(0.08, 0.14)
    grip = style.wood() if rng.random() < 0.6 else style.body(0.1)
    metal = style.metal()
    parts = [(rod((-length, 0, 1.3 * r), (0, 0, 1.3 * r), r, 0.8 * r), grip)]
    parts.append((rounded_box((2.6 * r, head, 2.6 * r), 0.3 * r), metal))
    if rng.random() < 0.5:
        parts.append((rod((0, head / 2, 1.3 * r), (0, head / 2 + 0.02, 1.3 * r), 1.5 * r), metal))
    return made("hammer", parts)


def screwdriver(rng: Rng, style: Style) -> Item:
    """A screwdriver, chisel or file: a fat grip, sometimes of two colours, and a thin blade."""
    length, r = rng.uniform(0.08, 0.2), rng.uniform(0.011, 0.018)
    parts = [(blob(rng, (0.11, 2 * r, 2 * r), 0.02, 0.6), style.body(0.2))]
    if rng.random() < 0.5:
        parts.append((rod((0.015, 0, r), (0.035, 0, r), 1.05 * r), style.body()))
    parts.append((rod((0.05, 0, r), (0.05 + length, 0, r), rng.uniform(0.003, 0.006)), style.metal()))
    return made("screwdriver", parts)


def pliers(rng: Rng, style: Style) -> Item:
    """Pliers or scissors: two crossed levers with coloured grips."""
    size, spread = rng.uniform(0.14, 0.24), rng.uniform(0.1, 0.35)
    grip, metal, parts = style.body(0.2), style.metal(), []
    for side in (-1, 1):
        jaw = np.array([[0, -0.01], [0.4 * size, -0.002], [0.4 * size, 0.006], [0, 0.012]])
        parts.append((turned(slab(jaw, 0.009), euler(side * spread * 0.4)), metal))
        end = (-0.6 * size, side * spread * 0.35 * size, 0.006)
        parts.append((rod((0, 0, 0.006), end, 0.005, 0.008), grip))
    return made("pliers", [*parts, (cylinder(0.012, 0.014), metal)])


def wrench(rng: Rng, style: Style) -> Item:
    """A spanner: a flat bar with a ring and a fork."""
    size, t, metal = rng.uniform(0.12, 0.3), rng.uniform(0.005, 0.01), style.metal()
    wide = 0.11 * size
    parts = [(box((size, 0.8 * wide, t)), metal), (ring(wide, 0.4 * wide, (size / 2 + wide, 0, t / 2)), metal)]
    for side in (-1, 1):
        parts.append((box((1.6 * wide, 0.5 * wide, t), (-size / 2 - 0.7 * wide, side * 0.8 * wide, 0)), metal))
    return made("wrench", parts)


def drill(rng: Rng, style: Style) -> Item:
    """A cordless drill, lying on its side or standing on its battery."""
    body, rubber = style.body(0.2), paint.plain(rng, np.array([0.1, 0.1, 0.11]))
    parts = [(rod((-0.1, 0, 0.17), (0.07, 0, 0.17), 0.032, 0.03), body)]
    parts.append((rod((0.07, 0, 0.17), (0.13, 0, 0.17), 0.02, 0.012), style.metal()))
    parts.append((turned(rounded_box((0.045, 0.04, 0.14), 0.015), euler(0, 0, -0.2), (-0.05, 0, 0.03)), rubber))
    parts.append((rounded_box((0.11, 0.075, 0.055), 0.01, (-0.04, 0, 0)), body if rng.random() < 0.5 else rubber))
    return made("drill", parts)


def saw(rng: Rng, style: Style) -> Item:
    """A hand saw, flat."""
    size = rng.uniform(0.3, 0.5)
    blade = np.array([[0, -0.05], [size, -0.05], [size, -0.02], [0, 0.06]])
    grip = [
        (rounded_box((0.1, 0.11, 0.022), 0.008, (-0.04, 0, 0)), style.wood() if rng.random() < 0.5 else style.body())
    ]
    return made("saw", [(turned(slab(blade, 0.0015), np.eye(3), (0, 0, 0.01)), style.metal()), *grip])


def pipe(rng: Rng, style: Style) -> Item:
    """A pipe or bar, straight or with elbows, and now and then a flange."""
    r, length = rng.uniform(0.006, 0.04), rng.uniform(0.25, 1.2)
    coat = style.metal() if rng.random() < 0.6 else style.body(0.2)
    if rng.random() < 0.6:
        hollow = cylinder(r, length) if rng.random() < 0.4 else cup(r, length, 0.15 * r)
        parts = [(turned(hollow, euler(0, 0, np.pi / 2), (-length / 2, 0, r)), coat)]
    else:
        bend = np.linspace(0, np.pi / 2, 9)
        corner = np.stack([length / 2 + 3 * r * np.sin(bend), 3 * r * (1 - np.cos(bend)), 0 * bend], axis=1)
        end = corner[-1] + [0, rng.uniform(0.1, 0.5) * length, 0]
        path = np.concatenate([[[-length / 2, 0, 0]], corner, [end]]) + np.array([0, 0, r])
        parts = [(tube(path, r, 12), coat)]
    if rng.random() < 0.3:
        parts.append((rod((-0.45 * length, 0, r), (-0.45 * length + 0.015, 0, r), 1.7 * r), style.metal()))
    return made("pipe", parts)


def board(rng: Rng, style: Style) -> Item:
    """A plank, batten or panel."""
    length, wide, t = rng.uniform(0.25, 1.4), rng.uniform(0.03, 0.3), rng.uniform(0.008, 0.05)
    coat = style.wood() if rng.random() < 0.75 else style.body(0.1)
    return made("board", [(box((length, wide, t)), coat)])


def brick(rng: Rng, style: Style) -> Item:
    """A brick or block."""
    tone = paint.pick(rng, ((0.6, 0.28, 0.2), (0.6, 0.58, 0.55), (0.75, 0.6, 0.45)))
    size = (0.24, rng.uniform(0.1, 0.2), rng.uniform(0.06, 0.14))
    return made("brick", [(box(size), prints.rough(rng, tone, 0.3))])


def bucket(rng: Rng, style: Style) -> Item:
    """A bucket with a bail, or a tub; a can of paint."""
    r, h = rng.uniform(0.09, 0.17), rng.uniform(0.14, 0.32)
    coat = style.body(0.2) if rng.random() < 0.6 else style.metal()
    parts = [(cup(r, h, 0.004, flare=rng.uniform(1, 1.35)), coat)]
    if rng.random() < 0.7:
        angle = np.linspace(0, np.pi, 14)
        drop = rng.uniform(-0.4, 0.6)
        path = np.stack(
            [r * np.cos(angle), -r * np.sin(angle) * (1 - abs(drop) / 2), h + drop * 0.3 * r * np.sin(angle)], 1
        )
        parts.append((tube(path, 0.004), style.metal()))
    if rng.random() < 0.4:
        parts.append((cylinder(0.75 * r, 0.004, (0, 0, rng.uniform(0.3, 0.8) * h)), style.body()))
    return made("bucket", parts, hollow=True)


def canister(rng: Rng, style: Style) -> Item:
    """A jerrycan: a rounded box with a handle and a cap."""
    w, d, h = rng.uniform(0.15, 0.3), rng.uniform(0.1, 0.16), rng.uniform(0.2, 0.36)
    coat = style.body(0.2)
    parts = [
        (rounded_box((w, d, 0.85 * h), 0.03), coat),
        (cylinder(0.025, 0.05, (0.35 * w, 0, 0.83 * h)), style.body()),
    ]
    parts.append((box((0.4 * w, 0.02, 0.02), (-0.05 * w, 0, h - 0.02)), coat))
    parts += [(box((0.02, 0.02, 0.15 * h), (-0.05 * w + x * 0.19 * w, 0, 0.85 * h)), coat) for x in (-1, 1)]
    return made(
        "canister", [*parts, (box((0.6 * w, d + 0.001, 0.3 * h), (0, 0, 0.3 * h)), style.package((0.6 * w, 0.3 * h)))]
    )


def coil(rng: Rng, style: Style) -> Item:
    """A coil of cable or hose."""
    r, t = rng.uniform(0.06, 0.2), rng.uniform(0.003, 0.012)
    angle = np.linspace(0, 2 * np.pi * rng.integers(4, 9), 160)
    sway = r * (1 + 0.08 * np.sin(0.37 * angle + rng.uniform(0, 6)))
    path = np.stack([sway * np.cos(angle), sway * np.sin(angle), t + 0.9 * t * angle / 6.28], axis=1)
    return made("cable", [(tube(path, t), style.body(0.2))], hollow=True)


def toolbox(rng: Rng, style: Style) -> Item:
    """A closed tool box: body, lid of another colour, handle, latches."""
    w, d, h = rng.uniform(0.3, 0.55), rng.uniform(0.16, 0.28), rng.uniform(0.14, 0.26)
    lid, dark = style.body(0.2), style.body(0.1)
    parts = [
        (rounded_box((w, d, 0.6 * h), 0.01), style.body(0.2)),
        (rounded_box((1.02 * w, 1.03 * d, 0.4 * h), 0.015, (0, 0, 0.58 * h)), lid),
    ]
    angle = np.linspace(0, np.pi, 10)
    path = np.stack([0.15 * w * np.cos(angle), 0 * angle, 0.97 * h + 0.05 * np.sin(angle)], axis=1)
    parts += [(tube(path, 0.008), dark)]
    parts += [(box((0.03, 0.01, 0.25 * h), (x * 0.3 * w, -0.52 * d, 0.45 * h)), dark) for x in (-1, 1)]
    return made("toolbox", parts)


def sack(rng: Rng, style: Style) -> Item:
    """A sack, lying or standing."""
    size = rng.uniform([0.3, 0.25, 0.12], [0.65, 0.45, 0.3])
    coat = style.package((size[0], size[1])) if rng.random() < 0.5 else paint.speckle(rng, style.color(), 0.2, 0.0)
    return made("sack", [(blob(rng, size, rng.uniform(0.04, 0.12), rng.uniform(0.5, 0.8)), coat)])


def tyre(rng: Rng, style: Style) -> Item:
    """A tyre or wheel, lying."""
    r = rng.uniform(0.1, 0.33)
    t = 0.28 * r
    rubber = paint.speckle(rng, np.array([0.09, 0.09, 0.1]), 0.15, 0.05, 0.3)
    parts = [(ring(r - t, t, (0, 0, t)), rubber)]
    if rng.random() < 0.5:
        parts.append((cylinder(r - 1.8 * t, 0.6 * t, (0, 0, 0.7 * t)), style.metal()))
    return made("tyre", parts, hollow=True)


def ladder(rng: Rng, style: Style) -> Item:
    """A ladder, rungs between two rails, lying along y."""
    length, wide = rng.uniform(1.2, 2.0), rng.uniform(0.3, 0.42)
    coat = style.metal() if rng.random() < 0.6 else style.wood()
    parts = [(box((0.03, 0.06, length), (x * wide / 2, 0, 0)), coat) for x in (-1, 1)]
    parts += [(box((wide, 0.035, 0.03), (0, 0, z)), coat) for z in np.arange(0.2, length - 0.1, 0.28)]
    return made("ladder", parts)


def broom(rng: Rng, style: Style) -> Item:
    """A broom, shovel or rake, standing on its head."""
    length, wide = rng.uniform(1.0, 1.5), rng.uniform(0.15, 0.4)
    head = box((wide, rng.uniform(0.01, 0.07), rng.uniform(0.08, 0.3)))
    return made("broom", [(head, style.body()), (rod((0, 0, 0.07), (0, 0, length), 0.013), style.wood())])


def reel(rng: Rng, style: Style) -> Item:
    """A reel, a roll of tape, a pot of nails: a turned body of two materials."""
    r, h = rng.uniform(0.03, 0.12), rng.uniform(0.02, 0.15)
    coat = style.body()
    if rng.random() < 0.4:
        profile = [(0.5 * r, 0), (r, 0), (r, h), (0.5 * r, h), (0.5 * r, 0)]
        return made("tape", [(lathe(profile, segments=32), coat)], hollow=True)
    ends = joined([cylinder(r, 0.008, (0, 0, z)) for z in (0, h + 0.008)])
    return made("reel", [(ends, coat), (cylinder(0.8 * r, h + 0.01), style.body())])


def helmet(rng: Rng, style: Style) -> Item:
    """A helmet: half a ball with a brim."""
    polar = np.linspace(0, np.pi / 2, 9)
    line: Array = np.stack([0.12 * np.cos(polar), 0.13 * np.sin(polar)], axis=1)
    dome = lathe([(0.15, 0.0), *map(tuple, line)])
    return made("helmet", [(dome, style.body(0.5)), (ball(0.012, (0, 0, 0.12)), style.body())])


#: What lies on a bench or in a tool bin, and how often.
TOOLS: tuple[tuple[Maker, float], ...] = (
    (hammer, 1.5),
    (screwdriver, 1.5),
    (pliers, 1.2),
    (wrench, 1.2),
    (drill, 1.2),
    (saw, 0.7),
    (pipe, 1.2),
    (board, 1.2),
    (brick, 0.6),
    (coil, 1.0),
    (reel, 1.2),
    (tin, 1.0),
    (packet, 1.5),
    (basket, 0.6),
    (helmet, 0.4),
)
#: What stands on the floor of a workshop.
FLOOR: tuple[tuple[Maker, float], ...] = (
    (bucket, 1.5),
    (canister, 1.2),
    (toolbox, 1.5),
    (sack, 1.2),
    (tyre, 1.0),
    (coil, 0.7),
    (brick, 1.0),
    (board, 1.2),
    (pipe, 1.2),
    (packet, 1.5),
    (basket, 0.6),
)
