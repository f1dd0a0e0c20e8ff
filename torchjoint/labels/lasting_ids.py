"""After step 8, while a cloud grows: things keep their ids from result to result."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torchjoint.runtime.groups import find, most_frequent, with_none


class Changes(NamedTuple):
    """What became of the things of the result before."""

    born: tuple[int, ...]  #: ids of things that are new
    gone: tuple[int, ...]  #: ids of things that are nowhere any more, or in pieces
    merged: dict[int, int]  #: for each thing that is now in another one: the id of that one
    split: dict[int, int]  #: for each new thing that was a part of another one: the id of that one


class LastingIds:
    """Gives the segments of successive results ids that last.

    Results are compared cube by cube; a cube belongs to the segment that has most of its points. Each former thing is
    at home in the segment that has most of its cubes (ties: the lowest). A segment takes the id of the thing that is at
    home there with most cubes (ties: the oldest); the others have merged with it. Another segment takes back an id that
    has merged or is gone, if it has more than half of the cubes that this id had, and they are more than half of its
    own; the rest gets new ids. What is new or back was split off if more than half of its cubes are those of one former
    thing, else it is born. What has merged must have more than half of its cubes there, else it is gone.
    """

    def __init__(self) -> None:
        self._cube = torch.zeros(0, dtype=torch.int64)  # ascending
        self._id = torch.zeros(0, dtype=torch.int64)  # of each cube
        self._last = torch.zeros(0, dtype=torch.int64)  # of each cube the id before that one, -1 = none
        self._next = 0

    def name(self, cube: Tensor, segment: Tensor) -> tuple[Tensor, Changes]:
        """Names the segments of a new result.

        Args:
            cube: [N] int64, the cube of each point.
            segment: [N] int64, its segment, 0 ... S - 1.

        Returns:
            the id of each segment, [S] int64; and what has changed since the last result.
        """
        cube, group = torch.unique(cube, return_inverse=True)
        segment_of_cube = most_frequent(segment, group, torch.ones_like(group))  # ties: the lowest
        num_segments = int(segment.max()) + 1
        home: dict[int, int] = {}
        tenant: dict[int, int] = {}
        merged: dict[int, int] = {}  # the home of what is mostly in one segment
        parent: dict[int, int] = {}  # the former thing to which most of a segment belonged
        before_size = _sizes(self._id)
        now_size = torch.bincount(segment_of_cube).tolist()
        before, last = self._known(cube)
        for count, old, new in _shared(before, segment_of_cube):
            if old not in home:
                home[old] = new
                tenant.setdefault(new, old)
            if 2 * count > before_size[old]:
                merged[old] = new
            if 2 * count > now_size[new]:
                parent[new] = old
        living, last_size = set(tenant.values()), _sizes(self._last)
        for count, old, new in _shared(last, segment_of_cube):
            if old not in living and new not in tenant and 2 * count > max(last_size[old], now_size[new]):
                tenant[new] = old
                living.add(old)
        fresh = [new for new in range(num_segments) if new not in tenant]
        name = tenant | dict(zip(fresh, range(self._next, self._next + len(fresh)), strict=True))
        ids = torch.tensor([name[new] for new in range(num_segments)])
        had = set(before_size)
        appeared = [new for new in range(num_segments) if name[new] not in had]
        lost = sorted(had - living)
        changes = Changes(
            tuple(name[new] for new in appeared if new not in parent),
            tuple(old for old in lost if old not in merged),
            {old: name[merged[old]] for old in lost if old in merged},
            {name[new]: parent[new] for new in appeared if new in parent},
        )
        now = ids[segment_of_cube]
        self._last = torch.where((before == now) | (before < 0), last, before)
        self._cube, self._id, self._next = cube, now, self._next + len(fresh)
        return ids, changes

    def state(self) -> dict[str, Tensor | int]:
        """What :meth:`restore` takes."""
        return {"cube": self._cube, "id": self._id, "last": self._last, "next": self._next}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Goes on with the ids of another object."""
        cube, ids, last, after = state["cube"], state["id"], state["last"], state["next"]
        whole = all(one.dtype == torch.int64 and one.shape == (len(ids),) for one in (cube, ids, last))
        if not whole or type(after) is not int or not 0 <= after < 1 << 62 or bool((cube.diff() <= 0).any()):
            raise ValueError("ids: expected ascending cubes, two ids for each, and the next id")
        for name, numbers, least in (("ids", ids, 0), ("last ids", last, -1)):
            if len(ids) and not least <= int(numbers.min()) <= int(numbers.max()) < after:
                raise ValueError(f"{name}: expected {least} to {after - 1}, got {numbers.min()} to {numbers.max()}")
        self._cube, self._id, self._last, self._next = cube, ids, last, after

    def _known(self, cube: Tensor) -> tuple[Tensor, Tensor]:
        """The ids of cubes in the result before, and the ids before those, -1 = none."""
        place, is_known = find(self._cube, cube)
        place = place.where(is_known, -1)
        return with_none(self._id)[place], with_none(self._last)[place]


def _shared(ids: Tensor, segment: Tensor) -> list[tuple[int, int, int]]:
    """(number of shared cubes, id, segment): most cubes first, then the oldest and the lowest; -1 is no id."""
    known = ids >= 0
    pairs, count = torch.unique(torch.stack([ids[known], segment[known]]), dim=1, return_counts=True)
    order = torch.argsort(count, descending=True, stable=True)
    return list(zip(count[order].tolist(), *pairs[:, order].tolist(), strict=True))


def _sizes(ids: Tensor) -> dict[int, int]:
    """How many cubes have each id; -1 is none."""
    found, count = ids[ids >= 0].unique(return_counts=True)
    return dict(zip(found.tolist(), count.tolist(), strict=True))
