"""Flat objects up to 1.5 cm thick: each function returns one instance, lying (z up) or hanging (front to -y)."""

from __future__ import annotations

from torchjoint_lab.synthetic.furnished import materials as paint
from torchjoint_lab.synthetic.furnished.arrays import Array, Rng
from torchjoint_lab.synthetic.furnished.clutter import magazine, sheet
from torchjoint_lab.synthetic.furnished.materials import Material
from torchjoint_lab.synthetic.furnished.mesh import box
from torchjoint_lab.synthetic.furnished.world import Item


def envelope(rng: Rng) -> Item:
    """An envelope, 1-4 mm thick, plain with an address."""
    w, d = (0.23, 0.16) if rng.random() < 0.5 else (0.32, 0.23)
    h = float(rng.uniform(0.001, 0.004))
    paper = paint.pick(rng, ((0.93, 0.93, 0.91), (0.75, 0.6, 0.4), (0.8, 0.74, 0.62)))
    return Item("envelope", (w, d, h), [(box((w, d, h)), paint.labelled(rng, paper, (w, d)))])


def folder(rng: Rng) -> Item:
    """A cardboard folder, plain, 3-12 mm thick."""
    w, d, h = 0.235, 0.315, float(rng.uniform(0.003, 0.012))
    return Item("folder", (w, d, h), [(box((w, d, h)), paint.plain(rng, paint.pick(rng, paint.VIVID + paint.SOBER)))])


def card(rng: Rng) -> Item:
    """A postcard or a photograph, 1 mm thick."""
    w, d = 0.15, 0.105
    return Item("card", (w, d, 0.001), [(box((w, d, 0.001)), paint.printed(rng, (w, d), pictures=1.0))])


def mat(rng: Rng) -> Item:
    """A place mat, 2-4 mm thick: plain, striped or mottled."""
    w, d, h = rng.uniform(0.38, 0.46), rng.uniform(0.28, 0.33), rng.uniform(0.002, 0.004)
    return Item("mat", (w, d, h), [(box((w, d, h)), _cloth(rng))])


def doormat(rng: Rng) -> Item:
    """A floor mat, 5-10 mm thick."""
    w, d, h = rng.uniform(0.55, 0.8), rng.uniform(0.38, 0.5), rng.uniform(0.005, 0.01)
    return Item("doormat", (w, d, h), [(box((w, d, h)), _cloth(rng))])


def lying(rng: Rng) -> Item:
    """A random paper object that lies on furniture or on the floor."""
    return (magazine, sheet, envelope, folder, card)[rng.integers(5)](rng)


def notice(rng: Rng, widest: float) -> Item:
    """An upright sheet on a door or a wall, 1 mm thick, at most ``widest`` metres wide."""
    w = min(0.21, widest)
    h = 1.4 * w
    page = paint.printed(rng, (w, h), paint.pick(rng, paint.SOBER[:1] + paint.VIVID), pictures=0.4)
    return Item("notice", (w, 0.001, h), [(box((w, 0.001, h)), page)])


def hatch(rng: Rng, tone: Array) -> Item:
    """A closed hatch, 3-6 mm thick, on a wall; nearly of the wall's colour ``tone`` [3]."""
    w, t, h = rng.uniform(0.35, 0.7), rng.uniform(0.003, 0.006), rng.uniform(0.4, 0.9)
    coat = paint.plain(rng, tone * rng.uniform(0.88, 0.97), gloss=0.2)
    return Item("hatch", (w, t, h), [(box((w, t, h)), coat)])


def panel(rng: Rng, width: float, height: float) -> Item:
    """A cupboard front of ``width`` x ``height`` metres, 4-8 mm thick, of another material than its neighbours."""
    t = float(rng.uniform(0.004, 0.008))
    coat = (
        paint.wood(rng, paint.pick(rng, paint.WOODS), upright=True)
        if rng.random() < 0.5
        else paint.plain(rng, paint.pick(rng, paint.VIVID + paint.SOBER[:3]), gloss=0.3)
    )
    return Item("panel", (width, t, height), [(box((width, t, height)), coat)])


def _cloth(rng: Rng) -> Material:
    color = paint.pick(rng, paint.VIVID + paint.SOBER)
    kind = rng.integers(3)
    if kind == 0:
        return paint.plain(rng, color)
    if kind == 1:
        return paint.stripes(rng, color, paint.pick(rng, paint.SOBER), rng.uniform(0.03, 0.1))
    return paint.speckle(rng, color, contrast=0.2, gloss=0.0)
