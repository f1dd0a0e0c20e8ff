"""Steps 7 and 8: look-up tables for label images."""

from __future__ import annotations

import torch
from torch import Tensor


def by_first_appearance(labels: Tensor, wanted: Tensor) -> Tensor:
    """The wanted labels ([K] bool) that occur in an image [H, W], in the order of their first pixels; [L] int64."""
    pixel = torch.nonzero(look_up(wanted, labels, False).view(-1)).squeeze(1)
    first_pixel = torch.full((wanted.shape[0],), labels.numel())
    first_pixel.scatter_reduce_(0, labels.reshape(-1)[pixel].long(), pixel, "amin")
    found = torch.nonzero(first_pixel < labels.numel()).squeeze(1)
    return found[torch.argsort(first_pixel[found])]


def look_up(table: Tensor, labels: Tensor, none: float) -> Tensor:
    """``table[labels]``, and `none` where a label is -1; several times faster than indexing."""
    table = torch.cat([table.new_full((1,), none), table])
    return table.index_select(0, labels.reshape(-1) + 1).view(labels.shape)
