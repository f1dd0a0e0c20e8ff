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
        checked: raises ValueError or TypeError for a setting that the method cannot be given; default: names are those
            of its space, values numbers.
        judged: what its setting is chosen by, "3D" or "2D" (where there is such truth).
    """

    name: str
    title: str
    run: Callable[[Case, Setting, bool], Result]
    space: Mapping[str, Space] = field(default_factory=dict)
    like: str | None = None
    judged: str = "3D"
    checked: Callable[[Setting], object] | None = None

    def check(self, setting: Setting) -> None:
        """Raises ValueError or TypeError, naming the parameter, for a setting that the method cannot be given."""
        if self.checked is not None:
            self.checked(setting)
            return
        known = {name for space in self.space.values() for name in space}
        for name, value in setting.items():
            if name not in known:
                raise ValueError(f"{name}: unknown parameter, expected one of {', '.join(sorted(known))}")
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise TypeError(f"{name}: expected a number, got {value!r}")

    def space_in(self, suite: str) -> Space:
        """The parameters that are searched in a suite."""
        return self.space.get(suite, self.space.get("", {}))
