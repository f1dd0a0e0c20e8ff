"""Deprecated names: they work as before, and warn with the name that replaces them."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable
from typing import NamedTuple, ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")


class Deprecation(NamedTuple):
    """A deprecated name, the first version that warns, the first version without it, and its replacement."""

    name: str
    since: str
    gone: str
    use: str

    def __str__(self) -> str:
        return f"{self.name} is deprecated since torchjoint {self.since}, removed in {self.gone}: use {self.use}"


DEPRECATIONS: list[Deprecation] = []  # of the whole package; a test compares them with its version


def deprecated(since: str, gone: str, use: str, name: str = "") -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Decorates a deprecated function. A call emits a FutureWarning, which Python shows once for each calling line.

    Args:
        since: the first version that warns.
        gone: the first version without the function; a test fails when the package reaches this version.
        use: the replacement, as the end of a sentence.
        name: what users call it; default: its module and name.
    """

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        deprecation = Deprecation(name or f"{function.__module__}.{function.__qualname__}", since, gone, use)
        DEPRECATIONS.append(deprecation)

        @functools.wraps(function)
        def warn_first(*args: P.args, **kwargs: P.kwargs) -> R:
            warnings.warn(str(deprecation), FutureWarning, stacklevel=2)
            return function(*args, **kwargs)

        return warn_first

    return decorate
