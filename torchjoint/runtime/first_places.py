"""Where groups begin in a tensor that is not sorted, and their numbers in this order."""

from __future__ import annotations

import torch
from torch import Tensor


def first_places(group: Tensor, count: int | None = None) -> Tensor:
    """The first place of each of the groups 0 ... `count` - 1 in [N] int64: [count] int64; N = it does not occur.

    Without `count`, the groups up to the highest one.

    >>> first_places(torch.tensor([2, 0, 2]), 3)
    tensor([1, 3, 0])
    """
    size = int(group.max()) + 1 if count is None else count
    return torch.full((size,), len(group)).scatter_reduce_(0, group, torch.arange(len(group)), "amin")


def numbers_by_first_place(group: Tensor, count: int) -> Tensor:
    """The number of each group if they are numbered by first appearance: [count] int64; arguments as above.

    >>> numbers_by_first_place(torch.tensor([2, 0, 2]), 3)
    tensor([1, 2, 0])
    """
    number = torch.empty(count, dtype=torch.int64)
    number[first_places(group, count).argsort()] = torch.arange(count)  # groups that do not occur come last
    return number
