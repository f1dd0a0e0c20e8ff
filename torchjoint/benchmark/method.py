"""What a method of the benchmark is."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from torch import Tensor

from torchjoint.benchmark.case import Case
from torchjoint.benchmark.space import Setting, Space


class Result(NamedTuple):
    """Labels of a scene, as far as a method makes them."""

    points: Tensor | None  #: [N] int64
    images: Sequence[Tensor] = ()  #: [H, W] int64 each


@dataclass(frozen=True)
class Method:
    """A way to segment a scene.

    Args:
        name: short, for files.
        title: for tables.
        run: from a scene, a setting and whether images are wanted, to labels.
        space: of its parameters in a suite, by the suite's name; "" = in all others.
        like: name of the method whose setting it uses instead of one of its own.
        judged: what its setting is chosen by, "3D" or "2D" (where there is such truth).
    """

    name: str
    title: str
    run: Callable[[Case, Setting, bool], Result]
    space: Mapping[str, Space] = field(default_factory=dict)
    like: str | None = None
    judged: str = "3D"

    def space_in(self, suite: str) -> Space:
        """The parameters that are searched in a suite."""
        return self.space.get(suite, self.space.get("", {}))
