"""Text files with an integer for each vertex of a mesh, a line each, as ScanNet's benchmark has them."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor


def read_vertex_numbers(path: Path, count: int) -> Tensor:
    """The `count` integers of a file -> [count] int64.

    Raises:
        FileNotFoundError, ValueError: naming the file and what is wrong with it.
    """
    words = read_text(path).split()
    if len(words) != count:
        raise ValueError(f"{path}: expected {count} numbers, one for each vertex, got {len(words)}")
    try:
        return torch.tensor([int(word) for word in words], dtype=torch.int64)
    except (ValueError, RuntimeError, OverflowError) as error:
        raise ValueError(f"{path}: expected integers: {error}") from error


def read_vertex_instances(path: Path, count: int) -> Tensor:
    """A ground truth of ScanNet's benchmark, class * 1000 + instance for each vertex, 0 = none.

    Returns:
        [count] int64: these numbers, -1 = none.

    Raises:
        FileNotFoundError, ValueError: naming the file and what is wrong with it.
    """
    values = read_vertex_numbers(path, count)
    if count and int(values.min()) < 0:
        raise ValueError(f"{path}: expected class * 1000 + instance, got {int(values.min())}")
    return torch.where(values == 0, -1, values)


def read_text(path: Path) -> str:
    """A text file's content; errors name the file."""
    try:
        return path.read_text(encoding="utf-8")
    except (FileNotFoundError, IsADirectoryError):
        raise FileNotFoundError(f"{path}: missing; expected a text file") from None
    except (UnicodeDecodeError, OSError, ValueError) as error:
        raise ValueError(f"{path}: expected a text file: {error}") from error
