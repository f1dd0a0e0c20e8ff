"""Groups in tensors: where they begin, their numbers, and their most frequent values."""

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


def with_none(table: Tensor) -> Tensor:
    """A table with one entry more, -1: that of index -1.

    >>> with_none(torch.tensor([5, 7]))[torch.tensor([1, -1, 0])]
    tensor([ 7, -1,  5])
    """
    return torch.cat([table, table.new_full((1,), -1)])


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
