"""What the tests know of each compiled operator; a file for each, which is found by its name.

``reference/NAME.py`` has

* ``NAME_reference``: a slow and simple Python version, which is easy to read;
* ``EXAMPLE``: arguments that are right, in the kernel's order;
* ``ERRORS``: changes of the example that the operator refuses, each with the type and the words of the error;
* ``REFUSED``: changes that the kernel refuses, where :data:`torch.ops` calls it without the wrapper's checks;
* ``long_call``, for most: a call that takes long enough to look at the threads.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any, NamedTuple

import torch

from torchjoint import ops
from torchjoint.ops import internal

Arguments = dict[str, Any]


class Operator(NamedTuple):
    """A compiled operator, and what is known about it."""

    name: str
    function: Callable[..., Any]
    example: Arguments
    errors: list[tuple[Arguments, type[Exception], str]]
    refused: list[Arguments]
    twin: Callable[..., Any] | None
    long_call: Callable[..., Callable[[], Any]] | None

    @property
    def kernel(self) -> Any:
        """As it is registered, without the wrapper."""
        return getattr(torch.ops.torchjoint, self.name).default


def operators() -> list[Operator]:
    """All operators: the public ones, and those that only the package calls."""
    defined = (name for name, value in vars(internal).items() if getattr(value, "__module__", "") == internal.__name__)
    return [_operator(name) for name in sorted([*ops.__all__, *(name for name in defined if name[0] != "_")])]


def _operator(name: str) -> Operator:
    known = import_module(f"reference.{name}")
    return Operator(
        name,
        getattr(ops if name in ops.__all__ else internal, name),
        known.EXAMPLE,
        known.ERRORS,
        known.REFUSED,
        getattr(known, f"{name}_reference", None),
        getattr(known, "long_call", None),
    )
