"""Where a scene's things come from: the built-in shapes and, if there is one, a catalogue of models."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from torchjoint_lab.synthetic import household, making
from torchjoint_lab.synthetic.furnished.arrays import Rng
from torchjoint_lab.synthetic.furnished.world import Item
from torchjoint_lab.synthetic.making import Maker
from torchjoint_lab.synthetic.style import Style

if TYPE_CHECKING:
    from torchjoint_lab.synthetic.catalogue import Catalogue

#: Share of the things that are models, where there are models.
_MODELS = 0.5


class Source:
    """Draws things.

    Args:
        rng: draws them.
        style: their materials.
        catalogue: models, or None.
        clutter: scales every number of things.
    """

    def __init__(self, rng: Rng, style: Style, catalogue: Catalogue | None, clutter: float) -> None:
        self.rng, self.style, self._catalogue, self._clutter = rng, style, catalogue, clutter

    def count(self, low: int, high: int) -> int:
        """A number of things, scaled by the scene's clutter, at least 1."""
        return max(round(self.rng.integers(low, high + 1) * self._clutter), 1)

    def of(self, things: Sequence[tuple[Maker, float]]) -> Item:
        """One of ``things`` by their weights."""
        return making.chosen(self.rng, self.style, things)

    def thing(self, most: float = 0.45, things: Sequence[tuple[Maker, float]] = household.THINGS) -> Item:
        """A model or one of ``things``, no side longer than ``most`` metres."""
        if self._catalogue is not None and self.rng.random() < _MODELS:
            model = self._catalogue.draw(self.rng, (0.03, most), carried=True)
            if model is not None:
                return model
        for _ in range(12):
            item = self.of(things)
            if max(item.size) <= most:
                return item
        return household.fruit(self.rng, self.style)

    def model(self, kinds: Sequence[str], low: float, high: float) -> Item | None:
        """A model whose name has one of ``kinds`` in it, its longest side within (low, high) metres; half the time."""
        if self._catalogue is None or self.rng.random() < 1 - _MODELS:
            return None
        return self._catalogue.draw(self.rng, (low, high), kinds)

    def chance(self, probability: float) -> bool:
        """True with that probability."""
        return bool(self.rng.random() < probability)

    def between(self, low: float, high: float) -> float:
        """A number, each as likely."""
        return float(self.rng.uniform(low, high))

    def tilt(self) -> float:
        """A tilt to lean with, radians."""
        return float(np.radians(self.rng.uniform(8, 30)))
