"""Furniture: each function returns one instance of random shape and material."""

from __future__ import annotations

import numpy as np

from torchjoint_lab.synthetic.furnished import materials as paint
from torchjoint_lab.synthetic.furnished.arrays import Rng
from torchjoint_lab.synthetic.furnished.materials import Material
from torchjoint_lab.synthetic.furnished.mesh import box, cup, cylinder, lathe
from torchjoint_lab.synthetic.furnished.world import Front, Item, Surface


def table(rng: Rng, top: Material) -> Item:
    """A table with four legs; its top has the given material."""
    w, d, h = rng.uniform(1.3, 1.9), rng.uniform(0.8, 1.05), rng.uniform(0.71, 0.77)
    leg, thick = rng.uniform(0.05, 0.1), rng.uniform(0.025, 0.05)
    frame = top if rng.random() < 0.6 else paint.plain(rng, paint.pick(rng, paint.SOBER), gloss=0.3)
    parts = [(box((w, d, thick), (0, 0, h - thick)), top)]
    for x in (-1, 1):
        for y in (-1, 1):
            parts.append((box((leg, leg, h - thick), (x * (w - leg) / 2 * 0.97, y * (d - leg) / 2 * 0.95)), frame))
        parts.append((box((0.02, d * 0.8, 0.07), (x * (w / 2 - leg), 0, h - thick - 0.07)), frame))
    return Item("table", (w, d, h), parts, [Surface((-w / 2, -d / 2), (w / 2, d / 2), h)])


def chair(rng: Rng, frame: Material, seat: Material, slats: int) -> Item:
    """A chair with ``slats`` in its back; the back is at +y."""
    w, d, h, back = 0.43, 0.43, 0.45, 0.93
    post = 0.038
    parts = [(box((w, d, 0.045), (0, 0, h - 0.045)), seat)]
    for x in (-1, 1):
        at_x = x * (w - post) / 2
        parts.append((box((post, post, h - 0.045), (at_x, -(d - post) / 2)), frame))
        parts.append((box((post, post, back), (at_x, (d + post) / 2 - 0.01)), frame))
        parts.append((box((0.02, d - post, 0.03), (at_x, 0, 0.2)), frame))
    gap = (back - 0.03 - 0.56) / slats
    for i in range(slats):
        z = 0.56 + (i + 1) * gap - 0.05
        tall = 0.085 if i == slats - 1 else 0.035
        parts.append((box((w - 2 * post, 0.018, tall), (0, (d + post) / 2 - 0.01, z - tall + 0.065)), frame))
    return Item("chair", (w, d + 2 * post, back), parts, [Surface((-w / 2, -d / 2), (w / 2, d / 2 - 0.05), h, 0.2)])


def cabinet(rng: Rng, front: Material, width: float, height: float, depth: float) -> Item:
    """A cabinet with doors or drawers, narrow joints between them, and a worktop if the cabinet is low."""
    carcass = front if rng.random() < 0.7 else paint.plain(rng, paint.pick(rng, paint.SOBER))
    handle = paint.plain(rng, paint.pick(rng, paint.SOBER[1:4]), gloss=0.8, absorbs=0.5)
    low, thick = height < 1.2, 0.035
    top = height - thick if low else height
    kick = 0.09
    parts = [
        (box((width, depth - 0.02, top - kick), (0, 0.01, kick)), carcass),
        (box((width - 0.02, depth - 0.07, kick), (0, 0.025)), handle),
    ]
    if low:
        dark = rng.random() < 0.5
        color = paint.pick(rng, paint.SOBER[3:5] if dark else paint.SOBER[:2] + paint.WOODS)
        worktop = paint.speckle(rng, color, gloss=0.7, absorbs=0.12 if dark else 0.0)
        parts.append((box((width + 0.01, depth + 0.015, thick), (0, -0.0075, top)), worktop))
    columns = max(round(width / rng.uniform(0.4, 0.6)), 1)
    fronts = []
    for column in range(columns):
        rows = int(rng.choice([1, 1, 1, 3])) if low else int(rng.choice([1, 2]))
        w, h = width / columns, (top - kick) / rows
        for row in range(rows):
            x, z = (column + 0.5) * w - width / 2, kick + row * h
            parts.append((box((w - 0.005, 0.02, h - 0.005), (x, -(depth - 0.02) / 2, z + 0.0025)), front))
            parts.append((box((min(0.16, w * 0.4), 0.018, 0.012), (x, -depth / 2 - 0.009, z + h - 0.07)), handle))
            reach = w / 2 - 0.01
            fronts.append(
                Front((x - reach, z + 0.01), (x + reach, z + h - 0.08), -depth / 2, front)
            )  # below the handle
    place = Surface((-width / 2, -depth / 2), (width / 2, depth / 2 - 0.022), height, 0.38 if low else 0.3)
    return Item("cabinet", (width, depth, height), parts, [place], fronts)


def bookcase(rng: Rng, body: Material, width: float) -> Item:
    """An open bookcase with a back panel; its boards are surfaces."""
    depth, height, t = rng.uniform(0.28, 0.36), rng.uniform(1.1, 1.9), 0.02
    shelves = int(height / rng.uniform(0.32, 0.4))
    parts = [(box((width, 0.012, height), (0, depth / 2 - 0.006)), body)]
    for x in (-1, 1):
        parts.append((box((t, depth - 0.012, height), (x * (width - t) / 2, -0.006)), body))
    surfaces = []
    for i in range(shelves + 1):
        z = 0.05 + i * (height - 0.05 - t) / shelves
        parts.append((box((width - 2 * t, depth - 0.012, t), (0, -0.006, z)), body))
        room = (height - 0.05 - t) / shelves - t if i < shelves else 0.5
        half = width / 2 - t - 0.005
        surfaces.append(Surface((-half, -depth / 2 + 0.01), (half, depth / 2 - 0.015), z + t, room - 0.01))
    return Item("bookcase", (width, depth, height), parts, surfaces, hollow=True)


def wall_shelf(rng: Rng, body: Material) -> Item:
    """One board on a wall; z = 0 is its lower side."""
    w, d = rng.uniform(0.7, 1.4), rng.uniform(0.18, 0.26)
    bracket = paint.plain(rng, paint.pick(rng, paint.SOBER[1:4]))
    parts = [(box((w, d, 0.022)), body)]
    for x in (-1, 1):
        parts.append((box((0.025, d * 0.8, 0.02), (x * w * 0.35, d * 0.1, -0.02)), bracket))
        parts.append((box((0.025, 0.015, 0.14), (x * w * 0.35, d / 2 - 0.0075, -0.15)), bracket))
    return Item("shelf", (w, d, 0.022), parts, [Surface((-w / 2, -d / 2), (w / 2, d / 2), 0.022, 0.6)])


def sofa(rng: Rng) -> Item:
    """A sofa or armchair: base, back and arms of one fabric."""
    w, d = rng.uniform(0.9, 1.7), rng.uniform(0.75, 0.88)
    cloth = paint.speckle(rng, paint.pick(rng, paint.VIVID + paint.SOBER[1:4]), contrast=0.12, gloss=0.0)
    arm, seat = 0.16, 0.4
    parts = [
        (box((w, d, seat - 0.12), (0, 0, 0.05)), cloth),
        (box((w, 0.2, 0.78), (0, d / 2 - 0.1, 0.05)), cloth),
    ]
    for x in (-1, 1):
        parts.append((box((arm, d, 0.55), (x * (w - arm) / 2, 0, 0.05)), cloth))
    cushions = 1 if w < 1.25 else 2
    width = (w - 2 * arm) / cushions
    for i in range(cushions):
        middle = (i + 0.5) * width - (w / 2 - arm)
        parts.append((box((width - 0.01, d - 0.2, 0.12), (middle, -0.1, seat - 0.07)), cloth))
    inner = Surface((-w / 2 + arm, -d / 2), (w / 2 - arm, d / 2 - 0.22), seat + 0.05, 0.5)
    return Item("sofa", (w, d, 0.83), parts, [inner])


def lamp(rng: Rng) -> Item:
    """A floor lamp: foot, thin pole (radius 9-14 mm), hollow shade."""
    metal = paint.plain(rng, paint.pick(rng, paint.SOBER[2:5]), gloss=0.7, absorbs=0.1)
    cloth = paint.plain(rng, paint.pick(rng, paint.SOBER[:1] + paint.VIVID), gloss=0.0)
    h, r = rng.uniform(1.45, 1.75), rng.uniform(0.009, 0.014)
    shade_r, shade_h = rng.uniform(0.15, 0.21), rng.uniform(0.2, 0.28)
    shade = lathe([(shade_r, 0), (shade_r * 0.65, shade_h), (shade_r * 0.65 - 0.004, shade_h), (shade_r - 0.004, 0)])
    parts = [
        (cylinder(0.13, 0.025), metal),
        (cylinder(r, h - 0.03, (0, 0, 0.025), segments=10), metal),
        (shade.moved((0, 0, h - shade_h)), cloth),
    ]
    return Item("lamp", (2 * shade_r, 2 * shade_r, h), parts)


def bin_(rng: Rng) -> Item:
    """A waste-paper bin, hollow."""
    r, h = rng.uniform(0.12, 0.16), rng.uniform(0.26, 0.36)
    plastic = paint.plain(rng, paint.pick(rng, paint.SOBER[2:] + paint.VIVID), gloss=0.3)
    return Item("bin", (2 * r, 2 * r, h), [(cup(r, h, 0.006, flare=1.3), plastic)], hollow=True)


def rug(rng: Rng, width: float, depth: float) -> Item:
    """A rug 6-10 mm thick: striped, checkered or mottled."""
    a, b = paint.pick(rng, paint.VIVID), paint.pick(rng, paint.VIVID + paint.SOBER)
    kind = rng.integers(3)
    if kind == 0:
        cloth = paint.stripes(rng, a, b, rng.uniform(0.1, 0.3), upright=bool(rng.integers(2)))
    elif kind == 1:
        cloth = paint.checker(rng, a, b, rng.uniform(0.2, 0.4))
    else:
        cloth = paint.speckle(rng, a, contrast=0.25, gloss=0.0)
    h = float(rng.uniform(0.006, 0.01))
    top = Surface((-width / 2, -depth / 2), (width / 2, depth / 2), h)
    return Item("rug", (width, depth, h), [(box((width, depth, h)), cloth)], [top])


def door(rng: Rng) -> Item:
    """A room door that is flush with its wall, except for 3 mm; leaf and handle are one instance."""
    w, h = rng.uniform(0.8, 0.95), rng.uniform(1.98, 2.08)
    leaf = (
        paint.wood(rng, paint.pick(rng, paint.WOODS), upright=True)
        if rng.random() < 0.6
        else paint.plain(rng, paint.pick(rng, paint.SOBER[:2] + paint.WALLS))
    )
    metal = paint.plain(rng, paint.pick(rng, paint.SOBER[1:3]), gloss=0.8, absorbs=0.4)
    knob = box((0.12, 0.02, 0.02), (w * 0.36, -0.05, 1.02))
    stem = box((0.02, 0.05, 0.02), (w * 0.36 + 0.05, -0.025, 1.02))
    return Item("door", (w, 0.003, h), [(box((w, 0.003, h)), leaf), (knob, metal), (stem, metal)])


def poster(rng: Rng) -> Item:
    """A paper poster on a wall, 1 mm thick; or a framed picture or white-board, up to 2 cm."""
    w, h = rng.uniform(0.2, 0.7), rng.uniform(0.25, 0.7)
    if rng.random() < 0.65:
        page = paint.printed(rng, (w, h), pictures=0.8)
        return Item("poster", (w, 0.001, h), [(box((w, 0.001, h)), page)])
    t = float(rng.uniform(0.012, 0.02))
    rim = paint.plain(rng, paint.pick(rng, paint.WOODS + paint.SOBER))
    page = paint.printed(rng, (w - 0.05, h - 0.05), pictures=1.0)
    front = box((w - 0.05, t - 0.004, h - 0.05), (0, -0.004, 0.025))
    bars = [box((0.025, t, h), (x * (w - 0.025) / 2, 0, 0)) for x in (-1, 1)]
    bars += [box((w - 0.05, t, 0.025), (0, 0, z)) for z in (0.0, h - 0.025)]
    return Item("picture", (w, t, h), [(front, page), *((bar, rim) for bar in bars)])


def screen(rng: Rng) -> Item:
    """A dark television on a wall; the depth sensor sees mostly a hole."""
    w = rng.uniform(0.7, 1.1)
    h, t = w * 0.58, 0.05
    case = paint.plain(rng, np.array([0.05, 0.05, 0.06]), gloss=0.4, absorbs=0.25)
    glass = paint.plain(rng, np.array([0.04, 0.045, 0.05]), gloss=0.9, absorbs=0.7)
    face = box((w - 0.04, 0.004, h - 0.04), (0, -t / 2 - 0.002, 0.02))
    return Item("screen", (w, t, h), [(box((w, t, h)), case), (face, glass)])
