"""Making items: what every maker of things needs."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from torchjoint_lab.synthetic.furnished.arrays import Array, Rng
from torchjoint_lab.synthetic.furnished.materials import Material
from torchjoint_lab.synthetic.furnished.mesh import Part
from torchjoint_lab.synthetic.furnished.world import Item
from torchjoint_lab.synthetic.style import Style

Maker = Callable[[Rng, Style], Item]


def made(name: str, parts: Sequence[tuple[Part, Material]], hollow: bool = False) -> Item:
    """An item of ``parts``, its size that of the box around them."""
    corners = np.concatenate([part.positions.reshape(-1, 3) for part, _ in parts])
    x, y, z = np.ptp(corners, axis=0)
    return Item(name, (float(x), float(y), float(z)), list(parts), hollow=hollow)


def log_uniform(rng: Rng, low: float, high: float) -> float:
    """A number between ``low`` and ``high``, as likely in each octave."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def chosen(rng: Rng, style: Style, things: Sequence[tuple[Maker, float]]) -> Item:
    """One of ``things``, by their weights."""
    weights: Array = np.array([weight for _, weight in things])
    return things[int(rng.choice(len(things), p=weights / weights.sum()))][0](rng, style)
