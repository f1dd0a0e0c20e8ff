"""Concave objects, larger and deeper than those of `furnished.clutter`: each function returns one instance."""

from __future__ import annotations

from torchjoint_lab.synthetic.furnished import materials as paint
from torchjoint_lab.synthetic.furnished.arrays import Rng
from torchjoint_lab.synthetic.furnished.materials import Material
from torchjoint_lab.synthetic.furnished.mesh import Part, box, cup
from torchjoint_lab.synthetic.furnished.world import Item, Surface


def crate(rng: Rng) -> Item:
    """An open box of boards or cardboard, 0.3-0.5 m wide; can hold things."""
    w, d, h, t = rng.uniform(0.32, 0.5), rng.uniform(0.26, 0.38), rng.uniform(0.16, 0.3), 0.012
    body = _board(rng)
    inside = Surface((-w / 2 + t, -d / 2 + t), (w / 2 - t, d / 2 - t), t, h)
    return Item("crate", (w, d, h), [(part, body) for part in _open_box(w, d, h, t)], [inside], hollow=True)


def basket(rng: Rng) -> Item:
    """A round basket, wider at the top, striped like wicker."""
    r, h = rng.uniform(0.14, 0.22), rng.uniform(0.16, 0.32)
    tone = paint.pick(rng, paint.WOODS)
    wicker = paint.stripes(rng, tone, tone * 0.8, 0.02)
    return Item("basket", (2 * r, 2 * r, h), [(cup(r, h, 0.01, flare=1.25), wicker)], hollow=True)


def deep_bowl(rng: Rng) -> Item:
    """A bowl with a depth of about half its width."""
    r = rng.uniform(0.09, 0.14)
    h = r * rng.uniform(0.9, 1.2)
    glaze = paint.plain(rng, paint.pick(rng, paint.VIVID + paint.SOBER), gloss=0.5)
    return Item("bowl", (2 * r, 2 * r, h), [(cup(r, h, 0.006, rounded=True), glaze)], hollow=True)


def drawer(rng: Rng, width: float, depth: float, front: Material) -> Item:
    """A drawer, pulled out by ``depth`` metres; its face of material ``front`` is at -y; can hold things."""
    h, t = float(rng.uniform(0.12, 0.18)), 0.014
    body = _board(rng)
    inside = Surface((-width / 2 + t, -depth / 2 + t), (width / 2 - t, depth / 2 - t), t, h)
    *parts, face = ((part, body) for part in _open_box(width, depth, h, t))
    parts.append((face[0], front))
    return Item("drawer", (width, depth, h), parts, [inside], hollow=True)


def _open_box(w: float, d: float, h: float, t: float) -> list[Part]:
    """Bottom and four walls, ``t`` thick; the wall at -y is last; metres."""
    sides = [box((t, d, h), (x * (w - t) / 2, 0, 0)) for x in (-1, 1)]
    ends = [box((w - 2 * t, t, h), (0, y * (d - t) / 2, 0)) for y in (1, -1)]
    return [box((w - 2 * t, d - 2 * t, t)), *sides, *ends]


def _board(rng: Rng) -> Material:
    if rng.random() < 0.5:
        return paint.wood(rng, paint.pick(rng, paint.WOODS))
    return paint.plain(rng, paint.pick(rng, ((0.68, 0.52, 0.35), *paint.VIVID, *paint.SOBER)))
