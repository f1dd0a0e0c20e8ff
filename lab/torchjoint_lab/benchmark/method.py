"""The interface of a benchmark method: name, function, parameter ranges."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from torch import Tensor

from torchjoint_lab.benchmark.case import Case
from torchjoint_lab.benchmark.space import Setting, Space


class Result(NamedTuple):
    """Labels that a method predicts for a scene; a method may leave out points or images."""

    points: Tensor | None  #: [N] int64
    images: Sequence[Tensor] = ()  #: [H, W] int64 each


@dataclass(frozen=True)
class Method:
    """A segmentation method of the benchmark.

    Args:
        name: short, for file names.
        title: for tables.
        run: takes a scene, a setting, and whether image labels are wanted; returns labels.
        space: parameter ranges by suite name; key "" holds the ranges for all other suites.
        like: name of another method; this method then uses the setting of the other method.
        checked: raises ValueError or TypeError if the method cannot take a setting; default: parameter names must be in
            the method's space, and values must be numbers.
        judged: the labels by which its setting is chosen, "3D" or "2D" (where a scene has such ground truth).
    """

    name: str
    title: str
    run: Callable[[Case, Setting, bool], Result]
    space: Mapping[str, Space] = field(default_factory=dict)
    like: str | None = None
    judged: str = "3D"
    checked: Callable[[Setting], object] | None = None

    def check(self, setting: Setting) -> None:
        """Raises ValueError or TypeError, naming the parameter, if the method cannot take this setting."""
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
        """Returns the parameter ranges that are searched in a suite."""
        return self.space.get(suite, self.space.get("", {}))
