"""Arithmetic on many 3-vectors, in an order of operations that is written down: labels depend on the last bit."""

from __future__ import annotations

import torch
from torch import Tensor


def by_columns(vectors: Tensor) -> Tensor:
    """The same [N, 3], but each column in one piece of memory: columns are what is calculated with."""
    return vectors.T.contiguous().T


def rows_of(vectors: Tensor, index: Tensor) -> Tensor:
    """``vectors[index]``, [E, 3], of and into the layout of :func:`by_columns`."""
    return torch.stack([column.index_select(0, index) for column in vectors.unbind(1)]).T


def dot(first: Tensor, second: Tensor) -> Tensor:
    """Scalar products of vectors [N, 3], [N]: (x + y) + z."""
    x, y, z = (first * second).unbind(1)
    return (x + y) + z


def length(vectors: Tensor) -> Tensor:
    """Lengths of vectors [N, 3], [N]."""
    return dot(vectors, vectors).sqrt()


def rounded_length(vectors: Tensor) -> Tensor:
    """Lengths of vectors [N, 3], [N], correctly rounded.

    By way of float64: torch's float32 root (MKL's) is not always the nearest number; that of ScanNet's segmentator is.
    """
    return dot(vectors, vectors).double().sqrt().float()
