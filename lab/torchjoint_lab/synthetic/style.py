"""The style of one scene: frequency of prints, similarity of neighbours, and of glossy or absorbing materials."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from torchjoint_lab.synthetic import prints
from torchjoint_lab.synthetic.furnished import materials as paint
from torchjoint_lab.synthetic.furnished.arrays import Array, Rng
from torchjoint_lab.synthetic.furnished.materials import Material


class Style:
    """Draws the materials of a scene.

    Args:
        rng: draws them.
        similar: probability that a thing takes one of the scene's two house colours or its wood.
        printed: probability that a package or a cloth has a print within.
        difficult: probability that a thing is glossy, dark or half transparent to the depth sensor.
    """

    def __init__(self, rng: Rng, similar: float, printed: float, difficult: float) -> None:
        self._rng, self._similar, self._printed, self._difficult = rng, similar, printed, difficult
        self.house = [prints.any_color(rng), prints.any_color(rng)]
        self.house_wood = paint.wood(rng, paint.pick(rng, paint.WOODS), planks=int(rng.choice([0, 0, 2, 4, 8])))

    def color(self) -> Array:
        """[3] sRGB."""
        if self._rng.random() < self._similar:
            return np.clip(self.house[self._rng.integers(2)] * self._rng.normal(1, 0.03), 0.02, 0.98)
        return prints.any_color(self._rng)

    def body(self, gloss: float | None = None) -> Material:
        """Plastic, paint or glaze of one colour."""
        rng = self._rng
        shine = float(rng.choice([0.05, 0.2, 0.6])) if gloss is None else gloss
        kind = rng.random()
        if kind < 0.7:
            return self._spoiled(paint.plain(rng, self.color(), shine))
        return self._spoiled(
            paint.speckle(rng, self.color(), 0.15, shine) if kind < 0.85 else prints.worn(rng, self.color())
        )

    def package(self, face: tuple[float, float]) -> Material:
        """A packet, book, tin or label with a ``face`` (width, height) metres: mostly printed."""
        rng = self._rng
        if rng.random() >= self._printed:
            card = (0.68, 0.52, 0.35)
            color = np.asarray(card) * rng.uniform(0.85, 1.1) if rng.random() < 0.3 else self.color()
            return paint.labelled(rng, color, face) if rng.random() < 0.4 else paint.plain(rng, color)
        kind = rng.random()
        if kind < 0.5:
            return prints.package(rng, face)
        if kind < 0.7:
            return prints.photo(rng, face)
        if kind < 0.85:
            return paint.printed(rng, face, self.color())
        return prints.dots(rng, max(face) / rng.integers(2, 6)) if rng.random() < 0.5 else self.cloth()

    def cloth(self) -> Material:
        """Cloth: plain, striped, checked, flowered."""
        rng = self._rng
        if rng.random() >= self._printed:
            return paint.speckle(rng, self.color(), 0.1, 0.0)
        kind, pitch = rng.integers(4), float(np.exp(rng.uniform(np.log(0.03), np.log(0.5))))
        if kind == 0:
            return paint.stripes(rng, self.color(), prints.any_color(rng), pitch, upright=bool(rng.integers(2)))
        return (prints.motif, prints.plaid, prints.dots)[kind - 1](rng, pitch)

    def wood(self, upright: bool = False) -> Material:
        """Wood: the scene's own, or another."""
        rng = self._rng
        if rng.random() < self._similar:
            return self.house_wood
        return paint.wood(rng, paint.pick(rng, paint.WOODS), upright, int(rng.choice([0, 0, 2, 4, 8])))

    def metal(self) -> Material:
        """Metal: bright and bad for depth, or painted."""
        rng = self._rng
        tone = paint.pick(rng, paint.SOBER[1:4])
        return prints.brushed(rng, tone) if rng.random() < 0.6 else paint.plain(rng, tone, 0.7, 0.2)

    def top(self) -> Material:
        """A table's, a desk's or a counter's top."""
        rng = self._rng
        kind = rng.random()
        if kind < 0.45:
            return self.wood()
        if kind < 0.65:
            return paint.plain(rng, self.color(), gloss=rng.uniform(0, 0.5))
        if kind < 0.8:
            return prints.marble(rng, self.color(), rng.uniform(0.3, 1.2))
        return paint.speckle(rng, self.color(), rng.uniform(0.05, 0.3)) if kind < 0.9 else self.cloth()

    def floor(self) -> Material:
        """Planks, tiles with joints, carpet, concrete."""
        rng = self._rng
        kind, tone = rng.integers(5), paint.pick(rng, paint.SOBER[:4] + paint.WOODS)
        if kind == 0:
            return paint.wood(rng, paint.pick(rng, paint.WOODS), planks=8)
        if kind == 1:
            return paint.carpet(rng, tone)
        if kind == 2:
            return prints.rough(rng, tone, rng.uniform(0.5, 3))
        pitch = float(np.exp(rng.uniform(np.log(0.05), np.log(0.5))))
        strong = float(rng.choice([rng.uniform(0.3, 0.7), rng.uniform(1.2, 1.6)]))
        if kind == 3:
            return prints.joints(rng, tone, (pitch, pitch), strong)
        return paint.checker(rng, tone, paint.pick(rng, paint.SOBER), 2 * pitch)

    def wall(self) -> Material:
        """Paint, paper with a pattern, tiles, brick."""
        rng = self._rng
        kind, tone = rng.random(), paint.pick(rng, paint.WALLS)
        if kind < 0.55:
            return paint.plain(rng, tone, gloss=0.0)
        if kind < 0.7:
            return prints.joints(rng, tone, (rng.uniform(0.08, 0.3),) * 2, rng.uniform(0.6, 1.2))
        if kind < 0.8:
            return prints.joints(rng, paint.pick(rng, paint.WOODS), (0.24, 0.08), rng.uniform(1, 1.6), shift=True)
        return prints.motif(rng, rng.uniform(0.1, 0.5)) if kind < 0.9 else prints.rough(rng, tone, 1.0, 0.06)

    def _spoiled(self, material: Material) -> Material:
        rng = self._rng
        if rng.random() >= self._difficult:
            return material
        return replace(material, gloss=float(rng.uniform(0.5, 1.0)), absorbs=float(rng.uniform(0.1, 0.9)))
