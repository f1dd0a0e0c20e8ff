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
from pathlib import Path
from typing import Any, NamedTuple

import torch

import torchjoint

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
    """All operators: those that the package has a file of."""
    folder = Path(torchjoint.__file__).parent / "ops"
    return [_operator(path.stem) for path in sorted(folder.glob("[!_]*.py"))]


def _operator(name: str) -> Operator:
    known = import_module(f"reference.{name}")
    return Operator(
        name,
        getattr(import_module(f"torchjoint.ops.{name}"), name),
        known.EXAMPLE,
        known.ERRORS,
        known.REFUSED,
        getattr(known, f"{name}_reference", None),
        getattr(known, "long_call", None),
    )
