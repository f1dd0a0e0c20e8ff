"""Calls a compiled kernel, without gradient; its errors have the same types with every version of torch."""

from __future__ import annotations

import re
from typing import Any

import torch
from torch import Tensor


def call(kernel: Any, *arguments: Any) -> Any:
    """What ``kernel``, such as ``torch.ops.torchjoint.min_cut.default``, returns for the arguments, without gradient.

    Kernels throw C++ exceptions of the standard library. Up to 2.14, torch translates them to ValueError and
    MemoryError; from 2.15 on to RuntimeError, which is undone here. Where torch.compile traces there is nothing to
    catch yet: errors of compiled code are as torch translates them.

    Raises:
        ValueError: an argument is wrong; the message begins with its name.
        MemoryError: there is not enough memory.
    """
    arguments = tuple(value.detach() if isinstance(value, Tensor) else value for value in arguments)
    if torch.compiler.is_compiling():
        return kernel(*arguments)
    try:
        return kernel(*arguments)
    except RuntimeError as error:
        translated = _translated(str(error), [argument.name for argument in kernel._schema.arguments])
        if translated is None:
            raise
        raise translated from None


def _translated(message: str, names: list[str]) -> ValueError | MemoryError | None:
    """The exception that a kernel meant by a RuntimeError; None if the error is not the kernel's."""
    if message == "std::bad_alloc":
        return MemoryError("a compiled operator: not enough memory")
    first = re.match(r"\w+", message)
    return ValueError(message) if first is not None and first.group() in names else None
