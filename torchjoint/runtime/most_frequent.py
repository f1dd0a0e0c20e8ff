"""The most frequent value of each group."""

from __future__ import annotations

import torch
from torch import Tensor


def most_frequent(value: Tensor, group: Tensor, count: Tensor) -> Tensor:
    """The value that occurs most often in each of the groups 0 ... G - 1; of equally frequent ones the lowest.

    Args:
        value: [N] int64, >= 0.
        group: [N] int64, group of each value; each group occurs.
        count: [N] int64, how often the value occurs there.

    Returns:
        [G] int64.

    >>> most_frequent(torch.tensor([7, 3, 7, 5]), torch.tensor([0, 0, 0, 1]), torch.tensor([1, 2, 1, 4]))
    tensor([3, 5])
    """
    width = int(value.max()) + 1
    key, place = torch.unique(group * width + value, return_inverse=True)
    total = torch.zeros_like(key).index_add_(0, place, count)
    most = torch.zeros(int(group.max()) + 1, dtype=torch.int64).scatter_reduce(0, key // width, total, "amax")
    wins = total == most[key // width]
    best = torch.full_like(most, width)
    return best.scatter_reduce_(0, (key // width)[wins], (key % width)[wins], "amin")
