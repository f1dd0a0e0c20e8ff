"""Steps 3 and 6: arithmetic on many 3-vectors in a fixed order of operations, because labels depend on the last bit."""

from __future__ import annotations

import torch
from torch import Tensor


def by_columns(vectors: Tensor) -> Tensor:
    """The same [N, 3] with each column contiguous in memory, because calculations read whole columns."""
    return vectors.T.contiguous().T


def rows_of(vectors: Tensor, index: Tensor) -> Tensor:
    """``vectors[index]``, [E, 3]; input and output have the layout of :func:`by_columns`."""
    return torch.stack([column.index_select(0, index) for column in vectors.unbind(1)]).T


def dot(first: Tensor, second: Tensor) -> Tensor:
    """Scalar products [N] of vectors [N, 3], summed as (x + y) + z."""
    x, y, z = (first * second).unbind(1)
    return (x + y) + z


def length(vectors: Tensor) -> Tensor:
    """Lengths [N] of vectors [N, 3]."""
    return dot(vectors, vectors).sqrt()


def rounded_length(vectors: Tensor) -> Tensor:
    """Lengths [N] of vectors [N, 3], correctly rounded.

    The root is taken in float64: torch's float32 root (from MKL) is not always the nearest number, but the root in
    ScanNet's segmentator is.
    """
    return dot(vectors, vectors).double().sqrt().float()
