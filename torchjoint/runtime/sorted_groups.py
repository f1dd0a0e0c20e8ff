"""Groups in sorted tensors: their first places, their members, and the place of a number."""

from __future__ import annotations

import torch
from torch import Tensor


def starts_group(sorted_values: Tensor) -> Tensor:
    """[n] bool: True where a value differs from the one before it."""
    starts = torch.ones_like(sorted_values, dtype=torch.bool)
    starts[1:] = sorted_values[1:] != sorted_values[:-1]
    return starts


def members_of_groups(size: Tensor, groups: Tensor) -> tuple[Tensor, Tensor]:
    """Lists the members of some groups. The members of all groups are numbered consecutively, group by group.

    Args:
        size: [G] int64, number of members of each group.
        groups: [B] int64, the groups to list; a group may occur several times.

    Returns:
        [M] int64, index into `groups`, ascending; and [M] int64, number of the member.

    >>> members_of_groups(torch.tensor([2, 0, 3]), torch.tensor([2, 0]))
    (tensor([0, 0, 0, 1, 1]), tensor([2, 3, 4, 0, 1]))
    """
    count = size[groups]
    index = torch.repeat_interleave(torch.arange(len(groups)), count)
    shift = (size.cumsum(0) - size)[groups] - (count.cumsum(0) - count)
    return index, torch.arange(len(index)) + shift[index]


def find(ascending: Tensor, wanted: Tensor) -> tuple[Tensor, Tensor]:
    """Looks up numbers [M] in an ascending list [n]: their places [M] int64, and whether they are in it, [M] bool.

    >>> find(torch.tensor([2, 5]), torch.tensor([5, 3]))
    (tensor([1, 1]), tensor([ True, False]))
    """
    if not len(ascending):
        return torch.zeros_like(wanted), torch.zeros_like(wanted, dtype=torch.bool)
    place = torch.searchsorted(ascending, wanted).clamp_(max=len(ascending) - 1)
    return place, ascending[place] == wanted
