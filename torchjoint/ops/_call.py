"""Loads the compiled extension; calls its kernels, with errors of the same types in every version of torch."""

import re
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torchjoint.runtime.messages import is_out_of_memory


def _missing_extension(error: ImportError) -> str:
    """The error message if torchjoint._C does not load."""
    package = Path(__file__).parents[1]
    checkout = package.parent
    if (checkout / "pyproject.toml").is_file() and not list(package.glob("_C*")):
        return (
            f"this is the source folder of torchjoint, {package}, and it holds no compiled extension. Python finds it "
            "before an installed torchjoint because you are in its checkout. Leave the checkout (cd ..) to use the "
            f"installed one, or compile here: pip install -e '{checkout}'"
        )
    return (
        "the compiled extension torchjoint._C is missing or does not load: install the package again with "
        f"`pip install torchjoint`, with torch >= 2.10. The cause: {error}"
    )


try:
    import_module("torchjoint._C")
except ImportError as error:
    raise ImportError(_missing_extension(error)) from error

#: Integers beyond this do not fit an argument of a kernel.
LIMIT = 1 << 63


def call(name: str, *arguments: Any) -> Any:
    """Calls a kernel, such as ``torch.ops.torchjoint.min_cut``, by its name, without gradient; returns its result.

    Kernels throw C++ exceptions of the standard library. Up to version 2.14, torch translates them to ValueError and
    MemoryError. From 2.15 on, torch translates them to RuntimeError, which this function converts back. It cannot do
    this in compiled code: when torch.compile traces it, no error exists yet.
    """
    kernel = getattr(torch.ops.torchjoint, name).default
    arguments = tuple(value.detach() if isinstance(value, Tensor) else value for value in arguments)
    if torch.compiler.is_compiling():
        return kernel(*arguments)
    names = [argument.name for argument in kernel._schema.arguments]
    for name, argument, value in zip(names, kernel._schema.arguments, arguments, strict=False):
        if value is None and str(argument.type) == "Tensor":
            raise TypeError(f"{name}: expected a tensor, got None")
        if isinstance(value, int) and not -LIMIT <= value < LIMIT:
            raise ValueError(f"{name}: expected an integer of at most 64 bits, got {str(value)[:60]}")
    try:
        return kernel(*arguments)
    except RuntimeError as error:
        raise (_translated(error, names) or error) from None


def _translated(error: RuntimeError, names: list[str]) -> ValueError | MemoryError | None:
    """The exception that a kernel threw, from the message of a RuntimeError; None if a kernel did not throw it."""
    message = str(error)
    # Kernels call torch itself only to make tensors, which fails if there is no memory; up to 2.14 without the reason.
    if is_out_of_memory(error) or "API call failed" in message:
        return MemoryError("a compiled operator: not enough memory")
    first = re.match(r"\w+", message)
    return ValueError(message) if first is not None and first.group() in names else None


def dynamic_size() -> torch.SymInt:
    """A length that depends on values, for the result of a fake kernel."""
    return torch.library.get_ctx().new_dynamic_size()


def of_one_size(like: Tensor, *kinds: tuple[Any, ...]) -> tuple[Tensor, ...]:
    """Results of a fake kernel whose last sides have one such length: of each its dtype, and the sides before."""
    count = dynamic_size()
    return tuple(like.new_empty((*sides, count), dtype=dtype) for dtype, *sides in kinds)


def register_fakes(**fakes: Callable[..., Any]) -> None:
    """Registers for each operator what makes empty results of the right shapes and dtypes, as torch.compile needs."""
    for name, fake in fakes.items():
        torch.library.register_fake(f"torchjoint::{name}", fake)
