"""Small objects: each function returns one instance of random shape, colour and print."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from torchjoint_lab.synthetic.furnished import materials as paint
from torchjoint_lab.synthetic.furnished.arrays import Rng
from torchjoint_lab.synthetic.furnished.materials import Material
from torchjoint_lab.synthetic.furnished.mesh import Part, ball, box, cup, lathe, tube
from torchjoint_lab.synthetic.furnished.world import Item


def mug(rng: Rng) -> Item:
    """A mug with a handle: a straight hollow cylinder and a half ring."""
    r, h = rng.uniform(0.035, 0.045), rng.uniform(0.08, 0.105)
    glaze = _ceramic(rng)
    turn = np.linspace(-0.45 * np.pi, 0.45 * np.pi, 9)
    ring = np.stack([r - 0.006 + h * 0.36 * np.cos(turn), 0 * turn, h / 2 + h * 0.3 * np.sin(turn)], axis=1)
    parts = [(cup(r, h, 0.004), glaze), (tube(ring, 0.006), glaze)]
    return Item("cup", (2.9 * r, 2 * r, h), parts, hollow=True)


def bowl(rng: Rng) -> Item:
    """A round bowl, hollow."""
    r = rng.uniform(0.08, 0.15)
    h = r * rng.uniform(0.5, 0.8)
    return Item("bowl", (2 * r, 2 * r, h), [(cup(r, h, 0.005, rounded=True), _ceramic(rng))], hollow=True)


def plate(rng: Rng) -> Item:
    """A flat plate."""
    r = rng.uniform(0.09, 0.13)
    profile = [(0, 0), (0.6 * r, 0), (r, 0.02), (r, 0.023), (0.65 * r, 0.006), (0, 0.006)]
    return Item("plate", (2 * r, 2 * r, 0.023), [(lathe(profile), _ceramic(rng))])


def tray(rng: Rng) -> Item:
    """An open box: concave, with thin walls."""
    w, d, h, t = rng.uniform(0.18, 0.34), rng.uniform(0.14, 0.26), rng.uniform(0.05, 0.12), 0.006
    body = _case(rng, (w, h))
    parts = [(box((w, d, t)), body)]
    parts += [(box((t, d, h), (x * (w - t) / 2, 0, 0)), body) for x in (-1, 1)]
    parts += [(box((w, t, h), (0, y * (d - t) / 2, 0)), body) for y in (-1, 1)]
    return Item("tray", (w, d, h), parts, hollow=True)


def carton(rng: Rng) -> Item:
    """A closed box: plain, labelled, striped, or printed on all sides like a cereal packet."""
    tall = rng.random() < 0.4
    w, d = rng.uniform(0.1, 0.3), rng.uniform(0.06, 0.2)
    h = float(rng.uniform(0.15, 0.32) if tall else rng.uniform(0.05, 0.16))
    face = (w, h) if tall else (w, d)
    return Item("box", (w, d, h), [(box((w, d, h)), _case(rng, face))])


def sphere(rng: Rng) -> Item:
    """A ball or a fruit."""
    r = rng.uniform(0.03, 0.075)
    color = paint.pick(rng, paint.VIVID)
    skin = (
        paint.plain(rng, color, gloss=0.3)
        if rng.random() < 0.6
        else paint.stripes(rng, color, paint.pick(rng, paint.SOBER[:2]), r, upright=rng.random() < 0.5)
    )
    return Item("ball", (2 * r, 2 * r, 2 * r), [(ball(r), skin)])


def bottle(rng: Rng) -> Item:
    """A bottle or vase with a label around it."""
    r, h = rng.uniform(0.03, 0.045), rng.uniform(0.2, 0.3)
    neck = r * rng.uniform(0.3, 0.5)
    body = paint.plain(rng, paint.pick(rng, paint.VIVID + paint.SOBER), gloss=0.7, absorbs=0.2)
    sticker = paint.printed(rng, (2 * np.pi * r, 0.3 * h), pictures=0.3)
    profile = [(0, 0), (r, 0), (r, 0.55 * h), (0.9 * r, 0.63 * h), (neck, 0.78 * h), (neck, h), (0, h)]
    band = lathe([(r + 0.0004, 0), (r + 0.0004, 0.3 * h)], (0, 0, 0.15 * h))
    return Item("bottle", (2 * r, 2 * r, h), [(lathe(profile), body), (band, sticker)])


def can(rng: Rng) -> Item:
    """A tin with a printed side."""
    r, h = rng.uniform(0.032, 0.05), rng.uniform(0.08, 0.14)
    lid = paint.plain(rng, paint.pick(rng, paint.SOBER[1:2]), gloss=0.8, absorbs=0.2)
    label = paint.printed(rng, (2 * np.pi * r, h))
    side = lathe([(r, 0), (r, h)])
    top = lathe([(r, h), (r - 0.003, h), (r - 0.003, h - 0.003), (0, h - 0.003)])
    return Item("can", (2 * r, 2 * r, h), [(side, label), (top, lid)])


def book(rng: Rng) -> Item:
    """A lying book: one print for covers and spine, white pages."""
    w, d, h = rng.uniform(0.13, 0.21), rng.uniform(0.19, 0.28), rng.uniform(0.012, 0.045)
    return Item("book", (w, d, h), _book_parts(rng, w, d, h))


def standing_book(rng: Rng, height: float, depth: float) -> Item:
    """A standing book with its spine to the front (-y)."""
    t = float(rng.uniform(0.02, 0.06))
    cover = _cover(rng, (t, height))
    pages = paint.plain(rng, np.array([0.9, 0.88, 0.82]), gloss=0.0)
    parts = [(box((t, 0.002, height), (0, -depth / 2 + 0.001, 0)), cover)]
    parts += [(box((0.002, depth - 0.002, height), (x * (t / 2 - 0.001), 0.001, 0)), cover) for x in (-1, 1)]
    parts.append((box((t - 0.004, depth - 0.008, height - 0.006), (0, 0, 0.003)), pages))
    return Item("book", (t, depth, height), parts)


def magazine(rng: Rng) -> Item:
    """A magazine, 2-6 mm thick."""
    w, d, h = rng.uniform(0.19, 0.23), rng.uniform(0.26, 0.3), rng.uniform(0.002, 0.006)
    return Item("magazine", (w, d, h), [(box((w, d, h)), paint.printed(rng, (w, d), pictures=0.8))])


def sheet(rng: Rng) -> Item:
    """A sheet of paper, 1 mm."""
    w, d = (0.21, 0.297) if rng.random() < 0.7 else (0.148, 0.21)
    ground = paint.pick(rng, paint.SOBER[:1])
    return Item("paper", (w, d, 0.001), [(box((w, d, 0.001)), paint.printed(rng, (w, d), ground, pictures=0.25))])


def keyboard(rng: Rng) -> Item:
    """A keyboard: a flat box with a checker pattern of keys."""
    tone = paint.pick(rng, paint.SOBER)
    keys = paint.checker(rng, tone, tone * 0.85, 0.038)
    return Item("keyboard", (0.42, 0.14, 0.02), [(box((0.42, 0.14, 0.02)), keys)])


def laptop(rng: Rng) -> Item:
    """An open laptop: two thin boards at an angle; the dark screen seldom returns depth."""
    w, d = 0.34, 0.24
    case = paint.plain(rng, paint.pick(rng, paint.SOBER[1:5]), gloss=0.4)
    glass = paint.plain(rng, np.array([0.06, 0.07, 0.09]), gloss=0.8, absorbs=0.5)
    keys = paint.checker(rng, np.array([0.15, 0.15, 0.16]), np.array([0.1, 0.1, 0.11]), 0.036)
    lean = -float(rng.uniform(0.15, 0.4))

    def lid(part: Part) -> Part:
        return part.moved((0, d / 2, 0.014), pitch=lean)

    parts = [
        (box((w, d, 0.016)), case),
        (box((w * 0.85, d * 0.45, 0.001), (0, d * 0.15, 0.016)), keys),
        (lid(box((w, 0.007, 0.22))), case),
        (lid(box((w - 0.02, 0.001, 0.2), (0, -0.004, 0.01))), glass),
    ]
    return Item("laptop", (w, d + 0.16, 0.23), parts)


def twins(rng: Rng, material: Material) -> tuple[Item, Item]:
    """Two boxes of one material for placing side by side: only their shape separates them."""
    d, h = rng.uniform(0.1, 0.18), rng.uniform(0.08, 0.2)
    w = rng.uniform(0.1, 0.2, 2)
    heights = (h, h if rng.random() < 0.5 else h * rng.uniform(0.75, 0.95))
    one, two = (Item("box", (w[i], d, heights[i]), [(box((w[i], d, heights[i])), material)]) for i in (0, 1))
    return one, two


#: Objects that may stand on a surface, with their relative frequency.
THINGS: tuple[tuple[Callable[[Rng], Item], float], ...] = (
    (mug, 2.0),
    (bowl, 1.2),
    (plate, 0.6),
    (tray, 0.9),
    (carton, 2.0),
    (sphere, 0.8),
    (bottle, 1.0),
    (can, 0.9),
    (book, 1.2),
    (magazine, 1.6),
    (sheet, 1.4),
    (keyboard, 0.4),
    (laptop, 0.5),
)


def thing(rng: Rng) -> Item:
    """A random object of :data:`THINGS`."""
    weights = np.array([weight for _, weight in THINGS])
    return THINGS[rng.choice(len(THINGS), p=weights / weights.sum())][0](rng)


def _ceramic(rng: Rng) -> Material:
    color = paint.pick(rng, paint.SOBER[:1] if rng.random() < 0.5 else paint.VIVID + paint.SOBER)
    if rng.random() < 0.3:
        return paint.stripes(rng, color, paint.pick(rng, paint.VIVID), rng.uniform(0.02, 0.05))
    return paint.plain(rng, color, gloss=0.5)


def _case(rng: Rng, face: tuple[float, float]) -> Material:
    kind = rng.random()
    color = paint.pick(rng, ((0.68, 0.52, 0.35), *paint.VIVID, *paint.SOBER))
    if kind < 0.3:
        return paint.plain(rng, color)
    if kind < 0.55:
        return paint.labelled(rng, color, face)
    if kind < 0.65:
        return paint.stripes(rng, color, paint.pick(rng, paint.SOBER), rng.uniform(0.03, 0.08))
    return paint.printed(rng, face, color if rng.random() < 0.6 else None)


def _cover(rng: Rng, size: tuple[float, float]) -> Material:
    return paint.printed(rng, size, paint.pick(rng, paint.VIVID + paint.SOBER), pictures=0.5)


def _book_parts(rng: Rng, w: float, d: float, h: float) -> list[tuple[Part, Material]]:
    cover = _cover(rng, (w, d))
    pages = paint.plain(rng, np.array([0.9, 0.88, 0.82]), gloss=0.0)
    return [
        (box((w, d, 0.002)), cover),
        (box((w, d, 0.002), (0, 0, h - 0.002)), cover),
        (box((0.002, d, h - 0.004), (-w / 2 + 0.001, 0, 0.002)), cover),
        (box((w - 0.008, d - 0.008, h - 0.004), (-0.002, 0, 0.002)), pages),
    ]
