"""Groups of equal values in sorted tensors."""

from __future__ import annotations

import torch
from torch import Tensor


def starts_group(sorted_values: Tensor) -> Tensor:
    """[n] bool: True where a value differs from the one before it."""
    starts = torch.ones_like(sorted_values, dtype=torch.bool)
    starts[1:] = sorted_values[1:] != sorted_values[:-1]
    return starts
