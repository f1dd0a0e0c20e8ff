"""After step 8, while a cloud grows: things keep their ids from result to result."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torchjoint.runtime.groups import most_frequent


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
    home there with most cubes (ties: the oldest); the others have merged with it. All other segments get new ids, and
    ids do not come back. A new one was split off if more than half of its cubes are those of one former thing, else it
    is born. What has merged must have more than half of its cubes there, else it is gone.
    """

    def __init__(self) -> None:
        self._cube = torch.zeros(0, dtype=torch.int64)  # ascending
        self._id = torch.zeros(0, dtype=torch.int64)  # of each cube
        self._next = 0

    def name(self, cube: Tensor, segment: Tensor) -> tuple[Tensor, Changes]:
        """Names the segments of a new result.

        Args:
            cube: [N] int64, the cube of each point.
            segment: [N] int64, its segment, 0 ... S - 1.

        Returns:
            the id of each segment, [S] int64; and what has changed since the last result.
        """
        cube, segment_of_cube = _majority(cube, segment)
        num_segments = int(segment.max()) + 1
        home: dict[int, int] = {}
        tenant: dict[int, int] = {}
        merged: dict[int, int] = {}  # the home of what is mostly in one segment
        parent: dict[int, int] = {}  # the former thing to which most of a segment belonged
        before_size = dict(zip(*(one.tolist() for one in self._id.unique(return_counts=True)), strict=True))
        now_size = torch.bincount(segment_of_cube).tolist()
        for count, old, new in self._shared(cube, segment_of_cube):
            if old not in home:
                home[old] = new
                tenant.setdefault(new, old)
            if 2 * count > before_size[old]:
                merged[old] = new
            if 2 * count > now_size[new]:
                parent[new] = old
        fresh = [new for new in range(num_segments) if new not in tenant]
        name = tenant | dict(zip(fresh, range(self._next, self._next + len(fresh)), strict=True))
        ids = torch.tensor([name[new] for new in range(num_segments)])
        lost = sorted(set(self._id.tolist()) - set(tenant.values()))
        changes = Changes(
            tuple(name[new] for new in fresh if new not in parent),
            tuple(old for old in lost if old not in merged),
            {old: name[merged[old]] for old in lost if old in merged},
            {name[new]: parent[new] for new in fresh if new in parent},
        )
        self._cube, self._id, self._next = cube, ids[segment_of_cube], self._next + len(fresh)
        return ids, changes

    def state(self) -> dict[str, Tensor | int]:
        """What :meth:`restore` takes."""
        return {"cube": self._cube, "id": self._id, "next": self._next}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Goes on with the ids of another object."""
        cube, ids, after = state["cube"], state["id"], state["next"]
        whole = all(one.dtype == torch.int64 and one.shape == (len(ids),) for one in (cube, ids))
        if not whole or type(after) is not int or not 0 <= after < 1 << 62 or bool((cube.diff() <= 0).any()):
            raise ValueError("ids: expected ascending cubes, an id for each, and the next id")
        if len(ids) and not 0 <= int(ids.min()) <= int(ids.max()) < after:
            raise ValueError(f"ids: expected 0 to {after - 1}, got {int(ids.min())} to {int(ids.max())}")
        self._cube, self._id, self._next = cube, ids, after

    def _shared(self, cube: Tensor, segment: Tensor) -> list[tuple[int, int, int]]:
        """(number of shared cubes, former thing, segment): most cubes first, then the oldest and the lowest."""
        if not len(self._cube):
            return []
        place = torch.searchsorted(self._cube, cube).clamp(max=len(self._cube) - 1)
        known = self._cube[place] == cube
        pairs, count = torch.unique(torch.stack([self._id[place[known]], segment[known]]), dim=1, return_counts=True)
        order = torch.argsort(count, descending=True, stable=True)
        return list(zip(count[order].tolist(), *pairs[:, order].tolist(), strict=True))


def _majority(cube: Tensor, segment: Tensor) -> tuple[Tensor, Tensor]:
    """The cubes, ascending, and the segment that has most points of each; ties: the lowest."""
    cube, group = torch.unique(cube, return_inverse=True)
    return cube, most_frequent(segment, group, torch.ones_like(group))
