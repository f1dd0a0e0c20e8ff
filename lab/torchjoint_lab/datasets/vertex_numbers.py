"""Reads text files with one integer per mesh vertex, one per line, as in ScanNet's benchmark."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor


def read_vertex_numbers(path: Path, count: int) -> Tensor:
    """Reads the `count` integers of a file; returns [count] int64.

    Raises:
        FileNotFoundError, ValueError: the message names the file and its error.
    """
    words = read_text(path).split()
    if len(words) != count:
        raise ValueError(f"{path}: expected {count} numbers, one for each vertex, got {len(words)}")
    try:
        return torch.tensor([int(word) for word in words], dtype=torch.int64)
    except (ValueError, RuntimeError, OverflowError) as error:
        raise ValueError(f"{path}: expected integers: {error}") from error


def read_vertex_instances(path: Path, count: int) -> Tensor:
    """Reads a ground truth of ScanNet's benchmark: class * 1000 + instance for each vertex, 0 = none.

    Returns:
        [count] int64: these numbers, -1 = none.

    Raises:
        FileNotFoundError, ValueError: the message names the file and its error.
    """
    values = read_vertex_numbers(path, count)
    if count and int(values.min()) < 0:
        raise ValueError(f"{path}: expected class * 1000 + instance, got {int(values.min())}")
    return torch.where(values == 0, -1, values)


def read_text(path: Path) -> str:
    """Returns the content of a text file; errors name the file."""
    try:
        return path.read_text(encoding="utf-8")
    except (FileNotFoundError, IsADirectoryError):
        raise FileNotFoundError(f"{path}: missing; expected a text file") from None
    except (UnicodeDecodeError, OSError, ValueError) as error:
        raise ValueError(f"{path}: expected a text file: {error}") from error
