"""Parameter ranges: random draws from a range, and steps within it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

Setting = dict[str, Any]


@dataclass(frozen=True)
class Choice:
    """One of a few ordered values."""

    values: tuple[Any, ...]

    def draw(self, random: np.random.Generator) -> Any:
        """Returns a value, uniformly at random."""
        return self.values[int(random.integers(len(self.values)))]

    def near(self, value: Any, random: np.random.Generator) -> Any:
        """Returns the previous or the next value."""
        place = self.values.index(value) + (1 if random.integers(2) else -1)
        return self.values[min(max(place, 0), len(self.values) - 1)]


@dataclass(frozen=True)
class Between:
    """Numbers from low to high, uniform on a logarithmic scale; with `or_zero`, a third of the draws are 0."""

    low: float
    high: float
    whole: bool = False
    or_zero: bool = False

    def draw(self, random: np.random.Generator) -> float:
        """Returns a number at random."""
        if self.or_zero and random.uniform() < 1 / 3:
            return 0
        return self._rounded(math.exp(random.uniform(math.log(self.low), math.log(self.high))))

    def near(self, value: float, random: np.random.Generator) -> float:
        """Returns a number about a sixth of the logarithmic range away, or a thirtieth."""
        if value == 0:
            return self.low
        step = random.normal() * math.log(self.high / self.low) / (6 if random.integers(2) else 30)
        if self.or_zero and value * math.exp(step) < self.low:
            return 0
        return self._rounded(min(max(value * math.exp(step), self.low), self.high))

    def _rounded(self, value: float) -> float:
        return round(value) if self.whole else float(f"{value:.3g}")


Space = Mapping[str, Choice | Between]


def draw(space: Space, random: np.random.Generator) -> Setting:
    """Returns a random setting."""
    return {name: values.draw(random) for name, values in space.items()}


def near(setting: Setting, space: Space, random: np.random.Generator) -> Setting:
    """Returns the setting with one or two parameters moved."""
    names = list(space)
    moved = random.choice(names, size=min(len(names), int(random.integers(1, 3))), replace=False)
    return setting | {name: space[name].near(setting[name], random) for name in moved.tolist()}
