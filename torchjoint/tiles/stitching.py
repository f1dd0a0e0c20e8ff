"""Unites superpoints of neighbouring tiles, and decides which tile gives a point its label.

Two tiles share the points of their buffers, and both tiles segment these points. A superpoint of one tile and a
superpoint of the other are united if more than half of the shared points of each are in the other. So each superpoint
has at most one partner in each neighbouring tile, and a few common points do not unite superpoints.

A tile sees a superpoint whole if the superpoint ends before the outer part of the buffer. The label of a point comes
from the tile that sees the point's superpoint whole. If several tiles do, it comes from the tile in which the
superpoint has the most points. If no tile does, or if the sizes are equal, the tile that owns the point has precedence,
then the tile with the lower number. So a superpoint that crosses the edge of its tile is not cut there.

The united superpoints are numbered by their first points. The result depends only on the tiles' labels, not on the
order in which the tiles were segmented.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from torchjoint import ops
from torchjoint.runtime.groups import counted_pairs, numbers_by_first_place
from torchjoint.tiles.tile import OwnLabels, SharedLabels

Ints = npt.NDArray[np.int64]

#: Points that are renumbered at a time.
PART = 1 << 22


def stitch(
    neighbors: Sequence[tuple[int, int]],
    counts: Sequence[int],
    own: Callable[[int], OwnLabels],
    shared: Callable[[int], SharedLabels],
    labels: npt.NDArray[Any],
) -> int:
    """Writes the labels of the whole cloud: 0, 1, 2, ... in the order of their first points.

    Args:
        neighbors: pairs of tiles that share points.
        counts: the number of superpoints of each tile.
        own, shared: read a tile's labels of its own points, and of the points that are also in other tiles. At most two
            tiles are in memory at a time.
        labels: [N] integers; their type must be able to hold the sum of all counts. May be mapped from disk.

    Returns:
        the number of labels.
    """
    offset = np.cumsum([0, *counts])
    near: list[list[int]] = [[] for _ in counts]
    for one, other in neighbors:
        near[one].append(other)
        near[other].append(one)
    first, partners = np.full(offset[-1], len(labels)), [np.empty((0, 2), np.int64)]
    for tile, others in enumerate(near):
        here = shared(tile)
        mine = _Choice(here, offset[tile])
        for other in sorted(others):
            there = shared(other)
            mine.compare(there, offset[other])
            if tile < other:
                partners.append(matching_superpoints(here, there) + offset[[tile, other]])
        point, superpoint = own(tile)
        chosen = superpoint + offset[tile]
        chosen[np.searchsorted(point, mine.point)] = mine.superpoint
        labels[point] = chosen
        np.minimum.at(first, chosen, point)
    count, rank = _ranks(np.concatenate(partners), first, len(labels))
    for start in range(0, len(labels), PART):
        labels[start : start + PART] = rank[labels[start : start + PART]]
    return count


class _Choice:
    """Chooses the superpoints of those points of a tile that are also in other tiles."""

    def __init__(self, here: SharedLabels, offset: int) -> None:
        self.point = here.point[here.is_own]  #: [n] ascending
        self.superpoint = here.superpoint[here.is_own] + offset  #: [n] counted over all tiles
        self._size = here.whole_size[here.superpoint[here.is_own]]

    def compare(self, there: SharedLabels, offset: int) -> None:
        """Uses the superpoints of another tile where they are whole and larger."""
        _, mine, theirs = np.intersect1d(self.point, there.point, assume_unique=True, return_indices=True)
        superpoint = there.superpoint[theirs]
        larger = there.whole_size[superpoint] > self._size[mine]
        mine, superpoint = mine[larger], superpoint[larger]
        self.superpoint[mine] = superpoint + offset
        self._size[mine] = there.whole_size[superpoint]


def _ranks(united: Ints, first: Ints, none: int) -> tuple[int, Ints]:
    """The number of labels, and the label of each superpoint of all tiles, in the order of their first points.

    Superpoints to which no point was given (`first` is `none`) do not unite others.
    """
    group = ops.connected_components(torch.from_numpy(united[(first[united] < none).all(1)]).t(), len(first))
    order = torch.from_numpy(first).argsort()
    rank = numbers_by_first_place(group[order], int(group.max()) + 1 if len(group) else 0)[group].numpy()
    return int(rank[first < none].max(initial=-1)) + 1, rank


def matching_superpoints(one: SharedLabels, other: SharedLabels) -> Ints:
    """Pairs [P, 2] of superpoints of two tiles; more than half of the shared points of each are in the other."""
    _, here, there = np.intersect1d(one.point, other.point, assume_unique=True, return_indices=True)
    first, second = one.superpoint[here].astype(np.int64), other.superpoint[there].astype(np.int64)
    *pairs, count = counted_pairs(torch.from_numpy(first), torch.from_numpy(second)).numpy()
    most = np.maximum(np.bincount(first)[pairs[0]], np.bincount(second)[pairs[1]])
    return np.stack(pairs, axis=1)[2 * count > most]
