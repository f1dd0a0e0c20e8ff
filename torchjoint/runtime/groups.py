"""Tensors: are they dense? Groups in them: where they begin, their numbers, and their most frequent values."""

from collections.abc import Iterable

import torch
from torch import Tensor


def check_dense(value: object, name: str) -> Tensor:
    """Returns a value, which must be a tensor on the CPU whose numbers lie in a row."""
    if not isinstance(value, Tensor):
        raise TypeError(f"{name}: expected a torch.Tensor, got {type(value).__name__}")
    if value.device.type != "cpu":
        raise ValueError(f"{name}: expected a CPU tensor, got one on {value.device}")
    if value.layout != torch.strided or value.is_nested or value.is_quantized:
        kind = "nested tensors" if value.is_nested else value.dtype if value.is_quantized else value.layout
        raise TypeError(f"{name}: expected a dense tensor, got one of {kind}")
    return value


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
    of_pair, of_value, total = counted_pairs(group, value, count)
    return best_of_groups(of_pair, of_value, total, int(group.max()) + 1)[0]


def best_of_groups(group: Tensor, value: Tensor, score: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """The value with the highest score in each of the groups 0 ... `count` - 1, of several the lowest; and that score.

    Args:
        group: [N] int64, group of each value.
        value: [N] int64.
        score: [N] numbers.
        count: number of groups.

    Returns:
        [count] int64, -1 = the group does not occur; and [count] scores, 0 if it does not.

    >>> best_of_groups(torch.tensor([0, 0, 2]), torch.tensor([7, 3, 5]), torch.tensor([2, 2, 1]), 3)
    (tensor([ 3, -1,  5]), tensor([2, 0, 1]))
    """
    best = score.new_zeros(count).scatter_reduce_(0, group, score, "amax", include_self=False)
    wins = score == best[group]
    return torch.full((count,), -1).scatter_reduce_(0, group[wins], value[wins], "amin", include_self=False), best


def counted_pairs(one: Tensor, other: Tensor, count: Tensor | None = None) -> Tensor:
    """Pairs of numbers, each once, ascending, and how often each occurs.

    Args:
        one, other: [N] int64, >= 0, the two numbers of each pair.
        count: [N] int64, how often it counts; default: once.

    Returns:
        [3, K] int64: one number, the other, how often.

    >>> counted_pairs(torch.tensor([1, 0, 1]), torch.tensor([2, 5, 2])).tolist()
    [[0, 1], [5, 2], [1, 2]]
    """
    width = int(other.max()) + 1 if len(other) else 1
    if count is None:
        key, total = torch.unique(one * width + other, return_counts=True)
    else:
        key, place = torch.unique(one * width + other, return_inverse=True)
        total = torch.zeros_like(key).index_add_(0, place, count)
    return torch.stack([key // width, key % width, total])


def each_once(pairs: Iterable[tuple[int, int]]) -> dict[int, int]:
    """Matches greedily: takes the pairs, best first, of which neither number is in one that was taken before.

    >>> each_once([(0, 5), (1, 5), (1, 3)])
    {0: 5, 1: 3}
    """
    found: dict[int, int] = {}
    taken: set[int] = set()
    for one, other in pairs:
        if one not in found and other not in taken:
            found[one] = other
            taken.add(other)
    return found


def distinct(numbers: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """The distinct ones of [N] int64 numbers below `count`, ascending, and the place of each number among them.

    >>> distinct(torch.tensor([5, 2, 5]), 6)
    (tensor([2, 5]), tensor([1, 0, 1]))
    """
    if count > 4 * len(numbers) + 1024:  # too sparse for direct indexing, which is 5 times as fast below this limit
        return torch.unique(numbers, return_inverse=True)
    present = torch.zeros(count, dtype=torch.bool)
    present[numbers] = True
    return present.nonzero()[:, 0], (present.cumsum(0) - 1)[numbers]


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


def renumber_by_value(labels: Tensor) -> tuple[Tensor, Tensor]:
    """Returns the distinct labels [R] >= 0 of [N] labels >= -1, ascending, and each label's index [N]; -1 for -1."""
    values, place = distinct(labels + 1, int(labels.max()) + 2)
    none = int(values[0] == 0)
    return values[none:] - 1, place - none
