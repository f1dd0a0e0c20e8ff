"""Household things of random shape, material and print; each function draws one as one instance."""

from __future__ import annotations

import numpy as np

from torchjoint_lab.synthetic.furnished import materials as paint
from torchjoint_lab.synthetic.furnished.arrays import Rng
from torchjoint_lab.synthetic.furnished.materials import Material
from torchjoint_lab.synthetic.furnished.mesh import Part, ball, box, cup, cup_profiles, cylinder, lathe, tube
from torchjoint_lab.synthetic.furnished.world import Item
from torchjoint_lab.synthetic.making import Maker, log_uniform, made
from torchjoint_lab.synthetic.solids import blob, euler, ring, rod, rounded_box, slab, turned
from torchjoint_lab.synthetic.style import Style


def packet(rng: Rng, style: Style) -> Item:
    """A box of any proportions, sharp or rounded, printed or plain; its ends now and then of another material."""
    w, d, h = sorted((log_uniform(rng, 0.03, 0.32) for _ in range(3)), reverse=True)
    if rng.random() < 0.5:
        w, d, h = d, h, w
    d = max(d, 0.2 * w)
    face = (w, max(h, d))
    coat = style.package(face)
    body = box((w, d, h)) if rng.random() < 0.6 else rounded_box((w, d, h), log_uniform(rng, 0.003, 0.03))
    parts = [(body, coat)]
    if rng.random() < 0.2:  # a lid
        parts.append((box((1.01 * w, 1.01 * d, 0.1 * h), (0, 0, 0.91 * h)), style.body()))
    return made("box", parts)


def vessel(rng: Rng, style: Style) -> Item:
    """A bottle, jar, vase or flask turned from a random profile, with a cap and a label around it now and then."""
    r, h = rng.uniform(0.02, 0.06), rng.uniform(0.07, 0.32)
    steps = np.sort(rng.uniform(0.1, 0.95, rng.integers(1, 5)))
    shoulder, neck = rng.uniform(0.5, 0.9), rng.uniform(0.2, 0.95)
    heights = np.concatenate([[0.0], np.linspace(0.02, shoulder, 6), np.linspace(shoulder, 1, 6)[1:]])
    swell = np.interp(heights, [0, *steps, 1], rng.uniform(0.8, 1.0, len(steps) + 2)) if rng.random() < 0.5 else 1.0
    ease = 0.5 - 0.5 * np.cos(np.pi * np.clip((heights - shoulder) / (1 - shoulder), 0, 1))
    radii = r * swell * (1 - ease * (1 - neck))
    line = list(zip(radii, heights * h, strict=True))
    parts = [(lathe([(0.0, 0.0), *line, (0.0, h)]), style.body())]
    if rng.random() < 0.5:
        parts.append((cylinder(1.05 * r * neck, 0.12 * h, (0, 0, 0.97 * h), 20), style.body()))
    if rng.random() < 0.6 and np.isscalar(swell):
        low, high = 0.12 * h, shoulder * h * 0.85
        parts.append((lathe([(r + 0.0005, low), (r + 0.0005, high)]), style.package((6.28 * r, high - low))))
    return made("bottle", parts)


def tin(rng: Rng, style: Style) -> Item:
    """A tin, flat or tall, a print around it."""
    r, h = rng.uniform(0.025, 0.08), log_uniform(rng, 0.025, 0.2)
    label = style.package((6.28 * r, h))
    side = lathe([(0, 0), (r, 0), (r, h)], segments=32)
    return made(
        "can", [(side, label), (lathe([(r, h), (0.93 * r, h), (0.93 * r, h - 0.004), (0, h - 0.004)]), style.metal())]
    )


def cup_sides(
    radius: float, height: float, wall: float, flare: float = 1.0, rounded: bool = False
) -> tuple[Part, Part]:
    """The outside and the inside (with the rim) of a cup, so that they can have different materials."""
    outer, inner = cup_profiles(radius, height, wall, flare, rounded)
    return lathe(outer), lathe([outer[-1], *inner])


def _lined(
    rng: Rng, coat: Material, radius: float, height: float, wall: float, flare: float, rounded: bool
) -> list[tuple[Part, Material]]:
    """A cup or bowl; its inside has another colour in half of the cases, mostly white."""
    outside, inside = cup_sides(radius, height, wall, flare, rounded)
    own = rng.spawn(1)[0]  # so that nothing else in the scene changes
    if own.random() < 0.5:
        return [(outside, coat), (inside, coat)]
    color = np.array([0.93, 0.92, 0.88]) if own.random() < 0.6 else own.uniform(0.05, 0.95, 3)
    return [(outside, coat), (inside, paint.plain(own, color, own.uniform(0.05, 0.6)))]


def mug(rng: Rng, style: Style) -> Item:
    """A mug or cup, flared or straight, with a handle or without, empty or with a drink, sometimes lined."""
    r, h = rng.uniform(0.03, 0.055), rng.uniform(0.05, 0.13)
    coat = style.package((6.28 * r, h)) if rng.random() < 0.3 else style.body(0.5)
    parts = _lined(rng, coat, r, h, 0.004, flare=rng.uniform(1.0, 1.35), rounded=rng.random() < 0.2)
    if rng.random() < 0.8:
        turn = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 10)
        reach, rise = rng.uniform(0.25, 0.45) * h, rng.uniform(0.25, 0.38) * h
        path = np.stack([0.93 * r + reach * np.cos(turn), 0 * turn, 0.52 * h + rise * np.sin(turn)], axis=1)
        parts.append((tube(path, rng.uniform(0.004, 0.007)), coat))
    if rng.random() < 0.5:
        drink = paint.plain(rng, paint.pick(rng, ((0.2, 0.12, 0.07), (0.55, 0.3, 0.1), (0.9, 0.9, 0.85))), 0.6)
        parts.append((cylinder(0.8 * r / 1.2, 0.002, (0, 0, rng.uniform(0.3, 0.6) * h)), drink))
    return made("cup", parts, hollow=True)


def bowl(rng: Rng, style: Style) -> Item:
    """A bowl, deep or shallow, or a pot."""
    r = rng.uniform(0.05, 0.16)
    h = r * rng.uniform(0.3, 1.2)
    coat = style.body(0.4) if rng.random() < 0.7 else style.wood()
    wall = rng.uniform(0.003, 0.008)
    parts = _lined(rng, coat, r, h, wall, rounded=rng.random() < 0.75, flare=rng.uniform(1, 1.4))
    return made("bowl", parts, hollow=True)


def plate(rng: Rng, style: Style) -> Item:
    """A plate or saucer, its rim painted now and then."""
    r, rise = rng.uniform(0.06, 0.15), rng.uniform(0.01, 0.03)
    inner = rng.uniform(0.5, 0.75) * r
    coat = style.body(0.5)
    line = [(0, 0), (inner, 0), (r, rise), (r, rise + 0.003), (inner, 0.005), (0, 0.005)]
    parts = [(lathe(line, segments=36), coat)]
    if rng.random() < 0.4:
        parts.append((ring(0.97 * r, 0.003, (0, 0, rise + 0.001)), style.body()))
    return made("plate", parts)


def book(rng: Rng, style: Style) -> Item:
    """A book lying: one print over covers and spine, the pages' edges white."""
    w, d = rng.uniform(0.1, 0.24), rng.uniform(0.14, 0.31)
    h = log_uniform(rng, 0.006, 0.06)
    cover, t = style.package((w, d)), 0.0015
    pages = paint.stripes(rng, np.array([0.9, 0.88, 0.82]), np.array([0.84, 0.82, 0.75]), 0.004)
    parts = [(box((w, d, t)), cover), (box((w, d, t), (0, 0, h - t)), cover)]
    parts.append((box((t, d, h - 2 * t), (-w / 2 + t / 2, 0, t)), cover))
    parts.append((box((w - 0.006, d - 0.006, h - 2 * t), (-0.002, 0, t)), pages))
    return made("book", parts)


def fruit(rng: Rng, style: Style) -> Item:
    """A ball, an apple, a pear, a lemon, a banana."""
    r, kind = rng.uniform(0.02, 0.06), rng.integers(4)
    skin = paint.speckle(rng, paint.pick(rng, paint.VIVID), rng.uniform(0, 0.15), 0.3)
    if kind == 0:
        return made("ball", [(ball(r), style.body() if rng.random() < 0.5 else style.package((3 * r, 3 * r)))])
    if kind == 1:
        angle = np.linspace(-1.1, 1.1, 12)
        path = np.stack([0.1 * np.sin(angle), 0.1 * np.cos(angle) - 0.07, 0 * angle + 0.02], axis=1)
        ends = [ball(0.016, (*path[i, :2], 0.004)) for i in (0, -1)]
        return made("fruit", [(tube(path, 0.018), skin), *((end, skin) for end in ends)])
    stalk = rod((0, 0, 1.6 * r), (0.2 * r, 0, 2.2 * r), 0.06 * r + 0.001)
    stretch = rng.uniform(0.8, 1.4)
    stem = paint.plain(rng, np.array([0.3, 0.22, 0.12]))
    return made("fruit", [(blob(rng, (2 * r, 2 * r, 2 * r * stretch), 0.05), skin), (stalk, stem)])


def bag(rng: Rng, style: Style) -> Item:
    """A bag, packet of crisps or cushion: a lump of printed cloth or foil."""
    w, d = rng.uniform(0.08, 0.35), rng.uniform(0.08, 0.3)
    h = rng.uniform(0.03, 0.16)
    coat = style.package((w, d)) if rng.random() < 0.6 else style.cloth()
    return made("bag", [(blob(rng, (w, d, h), rng.uniform(0.03, 0.15), rng.uniform(0.4, 1.0)), coat)])


def toy(rng: Rng, style: Style) -> Item:
    """Several convex parts of several colours, one on or beside another: a toy, an ornament, a gadget."""
    parts: list[tuple[Part, Material]] = []
    at = np.zeros(3)
    size = rng.uniform(0.03, 0.08)
    for _ in range(rng.integers(2, 6)):
        extent = size * rng.uniform(0.5, 1.5, 3)
        kind = rng.integers(4)
        if kind == 0:
            part = rounded_box(extent, 0.2 * extent.min(), at)
        elif kind == 1:
            part = cylinder(extent[0] / 2, extent[2], at.tolist())
        elif kind == 2:
            part = blob(rng, extent, 0.05, 1.0, at)
        else:
            part = lathe([(0, 0), (extent[0] / 2, 0), (0.1 * extent[0], extent[2]), (0, extent[2])], at.tolist())
        parts.append((part, style.body()))
        rise = 0.8 * extent[2] if rng.random() < 0.7 else 0.0
        at = at + np.append(rng.uniform(-0.4, 0.4, 2) * extent[:2], rise)
    return made("toy", parts)


def shoe(rng: Rng, style: Style) -> Item:
    """A shoe: a sole, a lumpy upper, an ankle."""
    length, width = rng.uniform(0.18, 0.3), rng.uniform(0.08, 0.11)
    sole, upper = style.body(0.0), style.body(0.1) if rng.random() < 0.6 else style.cloth()
    parts = [(rounded_box((length, width, 0.02), 0.009), sole)]
    parts.append((blob(rng, (0.95 * length, 0.9 * width, 0.09), 0.04, 0.8, (0, 0, 0.012)), upper))
    heel = rng.uniform(0.08, 0.14)
    parts.append((blob(rng, (0.45 * length, 0.85 * width, heel), 0.03, 0.8, (-0.24 * length, 0, 0.015)), upper))
    return made("shoe", parts)


def pan(rng: Rng, style: Style) -> Item:
    """A pan or pot with a long handle or two ears, a lid now and then."""
    r, h = rng.uniform(0.07, 0.15), rng.uniform(0.04, 0.15)
    metal, grip = style.metal(), style.body(0.1)
    parts = [(cup(r, h, 0.004, flare=rng.uniform(1, 1.2)), metal)]
    if rng.random() < 0.6:
        parts.append((rod((r, 0, 0.8 * h), (r + rng.uniform(0.1, 0.2), 0, h), 0.011), grip))
    else:
        parts += [(ring(0.03, 0.006, (x * (r + 0.01), 0, 0.8 * h)), grip) for x in (-1, 1)]
    lid = rng.random() < 0.3
    if lid:
        parts.append((lathe([(1.02 * r, h), (0.6 * r, h + 0.02), (0.02, h + 0.028), (0, h + 0.028)]), metal))
        parts.append((ball(0.014, (0, 0, h + 0.025)), grip))
    return made("pan", parts, hollow=not lid)


def cutlery(rng: Rng, style: Style) -> Item:
    """A knife, spoon or spatula."""
    length, coat = rng.uniform(0.14, 0.26), style.metal() if rng.random() < 0.6 else style.wood()
    grip = coat if rng.random() < 0.5 else style.body()
    head = rng.integers(3)
    parts = [(rounded_box((0.5 * length, 0.014, 0.008), 0.0035, (-0.25 * length, 0, 0.001)), grip)]
    if head == 0:
        outline = np.array([[0, -0.008], [0.5, -0.01], [0.46, 0.006], [0, 0.008]]) * [length, 1]
        parts.append((turned(slab(outline, 0.002), np.eye(3), (0, 0, 0.003)), coat))
    else:
        wide = rng.uniform(0.02, 0.05)
        parts.append((rod((0, 0, 0.005), (0.3 * length, 0, 0.005), 0.003), coat))
        parts.append(
            (blob(rng, (0.25 * length, wide, 0.009), 0.0, 1.0 if head == 1 else 0.4, (0.38 * length, 0, 0)), coat)
        )
    return made("cutlery", parts)


def teapot(rng: Rng, style: Style) -> Item:
    """A teapot, jug or watering can: a lump with a spout and a handle."""
    r, coat = rng.uniform(0.05, 0.09), style.body(0.6)
    h = r * rng.uniform(1.2, 2.2)
    line = [(0, 0), (0.7 * r, 0), (r, 0.4 * h), (0.7 * r, 0.85 * h), (0.45 * r, h), (0, 1.02 * h)]
    parts = [(lathe(line), coat), (ball(0.12 * r, (0, 0, h)), style.body())]
    parts.append((rod((0.8 * r, 0, 0.35 * h), (1.6 * r, 0, 0.9 * h), 0.18 * r, 0.1 * r), coat))
    angle = np.linspace(-1.4, 1.4, 10)
    path = np.stack([-0.75 * r - 0.6 * r * np.cos(angle), 0 * angle, 0.5 * h + 0.3 * h * np.sin(angle)], axis=1)
    return made("teapot", [*parts, (tube(path, 0.1 * r), coat)])


def basket(rng: Rng, style: Style) -> Item:
    """An open box or round basket."""
    w, d, h, t = rng.uniform(0.12, 0.36), rng.uniform(0.1, 0.28), rng.uniform(0.04, 0.2), rng.uniform(0.002, 0.01)
    coat = style.wood() if rng.random() < 0.3 else style.body() if rng.random() < 0.6 else style.package((w, h))
    if rng.random() < 0.3:
        return made("basket", [(cup(w / 2, h, t, flare=rng.uniform(1, 1.4)), coat)], hollow=True)
    sides = [box((t, d, h), (x * (w - t) / 2, 0, 0)) for x in (-1, 1)]
    ends = [box((w - 2 * t, t, h), (0, y * (d - t) / 2, 0)) for y in (-1, 1)]
    return made("tray", [(part, coat) for part in (box((w - 2 * t, d - 2 * t, t)), *sides, *ends)], hollow=True)


def plant(rng: Rng, style: Style) -> Item:
    """A pot with leaves or a small bush."""
    r, h = rng.uniform(0.04, 0.11), rng.uniform(0.06, 0.16)
    pot, green = style.body(), paint.pick(rng, ((0.16, 0.36, 0.14), (0.3, 0.42, 0.15), (0.12, 0.28, 0.2)))
    leaf = paint.speckle(rng, green, 0.3, 0.1)
    earth = paint.speckle(rng, np.array([0.2, 0.14, 0.1]), 0.3, 0.0)
    parts = [(cup(r, h, 0.006, flare=1.3), pot), (cylinder(0.75 * r, 0.01, (0, 0, 0.8 * h)), earth)]
    for _ in range(rng.integers(4, 14)):
        length, turn, rise = rng.uniform(0.06, 0.22), rng.uniform(-np.pi, np.pi), rng.uniform(0.2, 1.4)
        blade = blob(rng, (length, 0.28 * length, 0.004), 0.02, 1.0)
        moved = turned(blade, euler(turn) @ euler(0, 0, -rise), (0, 0, 0))
        out = np.array([np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), np.sin(rise)]) * length / 2
        parts.append((Part(moved.positions + out + [0, 0, 0.8 * h], moved.normals, moved.uv), leaf))
    return made("plant", parts)


#: Things for tables, shelves, bins and floors, and how often.
THINGS: tuple[tuple[Maker, float], ...] = (
    (packet, 4.0),
    (vessel, 2.5),
    (tin, 1.5),
    (mug, 2.0),
    (bowl, 1.2),
    (plate, 0.8),
    (book, 1.5),
    (fruit, 1.3),
    (bag, 1.2),
    (toy, 1.5),
    (shoe, 0.5),
    (pan, 0.6),
    (cutlery, 0.7),
    (teapot, 0.5),
    (basket, 0.7),
    (plant, 0.5),
)
