"""Step 6, method learned: the superpoints of a cloud, and what a model judges the boundaries between them by."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint.cloud.edge_weights import EDGES
from torchjoint.ops.internal import WEIGHT_UNIT
from torchjoint.runtime.groups import counted_pairs, members_of_groups
from torchjoint.runtime.memory import give_back
from torchjoint.runtime.threads import parallel_map
from torchjoint.scene.masks import Masks
from torchjoint.segments.learned.boundaries import Boundaries
from torchjoint.segments.learned.images import ImageCounts
from torchjoint.segments.learned.occluded_surfaces import Occlusions
from torchjoint.segments.learned.region_statistics import RegionStatistics, pooled, sum_by
from torchjoint.views.observations import Observation
from torchjoint.views.visibility import Visible

#: For clouds of more points, less memory counts more than less time: they are judged copy by copy.
MANY_POINTS = 400_000


def give_back_much(num_points: int) -> None:
    """Returns free memory to the system in the course of step 6, if the cloud is large."""
    if num_points > MANY_POINTS:
        give_back()


class MaskCounts(NamedTuple):
    """How many points of each superpoint lie in each mask. All M masks of all frames are numbered together."""

    in_mask: Tensor  #: [3, I] int64: superpoint, mask, number of points
    in_frame: Tensor  #: [3, J] int64: superpoint, frame, number of points that the frame sees
    weight: Tensor  #: [M] int64, score of each mask; WEIGHT_UNIT is the highest score of all
    frame_of_mask: Tensor  #: [M] int64, the frame of each mask; some frames may have no masks
    bare: Tensor  #: [2, K] int64: superpoint, number of points that a frame with masks sees in none

    def of_regions(self, of_superpoint: Tensor) -> tuple[Tensor, Tensor]:
        """`in_mask` and `in_frame` of regions instead of superpoints; `of_superpoint` [P] int64: the region of each."""
        rows = (self.in_mask, self.in_frame)
        in_mask, in_frame = (counted_pairs(of_superpoint[superpoint], key, count) for superpoint, key, count in rows)
        return in_mask, in_frame

    def unmasked(self, of_superpoint: Tensor) -> Tensor:
        """Whether most views show each region without a mask, [R] bool; argument as that of `of_regions`."""
        rows, num_regions = (self.bare, self.in_frame), int(of_superpoint.max()) + 1
        bare, in_view = (sum_by(of_superpoint[one[0]], one[-1], num_regions) for one in rows)
        return 2 * bare > in_view  # not by the points in masks: these may overlap


def masks_of_superpoints(
    superpoint: Tensor, observations: Sequence[Observation], is_counted: Callable[[int, Tensor], Tensor] | None = None
) -> MaskCounts | None:
    """Counts the visible points of each superpoint in each mask.

    Args:
        superpoint: [N] int64, superpoint of each point.
        observations: the frames; those without masks do not count.
        is_counted: (number of a frame, its visible points [V]) -> which of them count, [V] bool; None: all count.

    Returns:
        None if no frame has masks.
    """

    def count(frame: int) -> tuple[Tensor, Tensor, Tensor, int, Tensor] | None:
        seen = observations[frame]
        if seen.masks is None:
            return None
        chosen = slice(None) if is_counted is None else is_counted(frame, seen.visible.point)
        return _count(superpoint, seen.visible, seen.masks, frame, chosen)

    tables = [one for one in parallel_map(count, range(len(observations))) if one is not None]
    if not tables:
        return None
    in_masks, in_frame, scores, frames, bare = zip(*tables, strict=True)
    num_masks = torch.tensor([len(of_frame) for of_frame in scores])
    first = (num_masks.cumsum(0) - num_masks).tolist()
    in_mask = [rows + torch.tensor([[0], [start], [0]]) for rows, start in zip(in_masks, first, strict=True)]
    score = torch.cat(scores).double()
    weight = (score / (max(score.tolist(), default=0) or 1) * WEIGHT_UNIT).round().long()
    frame_of_mask = torch.tensor(frames).repeat_interleave(num_masks)
    return MaskCounts(torch.cat(in_mask, 1), torch.cat(in_frame, 1), weight, frame_of_mask, torch.cat(bare, 1))


def _count(
    superpoint: Tensor, visible: Visible, masks: Masks, frame: int, chosen: Tensor | slice
) -> tuple[Tensor, Tensor, Tensor, int, Tensor]:
    """For one frame: rows (superpoint, mask, points), (superpoint, frame, visible points); scores; number; `bare`."""
    there = superpoint[visible.point[chosen]]
    of_superpoint, num_seen = torch.unique(there, return_counts=True)
    in_frame = torch.stack([of_superpoint, torch.full_like(of_superpoint, frame), num_seen])
    atom = masks.atom[visible.row[chosen], visible.column[chosen]].long()
    region, atom, count = counted_pairs(there, atom)
    # Each atom counts for all masks in which it lies.
    atoms, mask = masks.pairs[:, torch.argsort(masks.pairs[0], stable=True)]
    row, member = members_of_groups(torch.bincount(atoms, minlength=masks.num_atoms), atom)
    bare = torch.stack([region, count])[:, ~torch.isin(atom, atoms)]
    return counted_pairs(region[row], mask[member], count[row]), in_frame, masks.scores, frame, bare


def pairs_in_one_group(member: Tensor, group: Tensor, num_members: int) -> Tensor:
    """Pairs of members [K] that are in one group [K] together: [2, B] int64, a < b, ascending."""
    order = torch.argsort(group, stable=True)
    member, group = member[order], group[order]
    first, second = members_of_groups(torch.bincount(group), group)  # each member meets all of its group
    one, other = member[first], member[second]
    key = torch.unique((one * num_members + other)[one < other])
    return torch.stack([key // num_members, key % num_members])


@dataclass(frozen=True)
class SuperpointGraph:
    """What is known about a cloud, its superpoints, and the boundaries between them.

    Attributes:
        superpoint: [N] int64, superpoint of each point, 0 ... P - 1, numbered by first appearance.
        pairs: [2, Q] int64, the pairs of superpoints a < b that edges connect, in ascending order.
        boundaries: what is known about the edges between the superpoints of each pair.
        statistics: statistics of the superpoints' points.
        typical_color_step: median colour step of all edges, units of Lab; None without colours.
        images: counts of points in image segments; None without images.
        masks: counts of points in masks; None without masks.
        occlusions: pairs of superpoints on two sides of an occluder in the images; None without images, and with masks.
    """

    superpoint: Tensor
    pairs: Tensor
    boundaries: Boundaries
    statistics: RegionStatistics
    typical_color_step: float | None
    images: ImageCounts | None
    masks: MaskCounts | None = None
    occlusions: Occlusions | None = None

    def __len__(self) -> int:
        """P, the number of superpoints."""
        return len(self.statistics.size)

    def without_measures(self) -> SuperpointGraph:
        """The same, of whose boundaries only the averages are known: they take a tenth of the memory."""
        return replace(self, boundaries=self.boundaries._replace(binned={}))

    def grouped(self, *groups: Tensor) -> SuperpointGraph:
        """Disjoint copies of the same, whose superpoints are groups of these, each its only point; without masks.

        Args:
            groups: for each copy [P] int64, group of each superpoint, 0 ... G - 1, numbered by first appearance. The
                superpoints of each copy follow those of the copy before it.
        """
        *starts, num_superpoints = accumulate((int(group.max()) + 1 for group in groups), initial=0)
        across, pairs, of_pair = zip(*(pairs_of(group, self.pairs) for group in groups), strict=True)
        images, occlusions = self.images, self.occlusions
        return SuperpointGraph(
            torch.arange(num_superpoints),
            torch.cat([ends + start for ends, start in zip(pairs, starts, strict=True)], 1),
            self.boundaries.grouped(across, of_pair, [ends.shape[1] for ends in pairs]),
            RegionStatistics.union([pooled(self.statistics, group, int(group.max()) + 1) for group in groups]),
            self.typical_color_step,
            None if images is None else ImageCounts.union([images.grouped(group) for group in groups], starts),
            None,
            None if occlusions is None else Occlusions.union([occlusions.grouped(group) for group in groups], starts),
        )


def pairs_of(superpoint: Tensor, edge_index: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The C edges across superpoints [N]; the Q pairs of superpoints [2, Q], ascending; the pair [C] of each edge."""
    blocks = enumerate(edge_index.split(EDGES, 1))  # less memory than all edges at once
    across = torch.cat(
        [torch.nonzero(superpoint[i] != superpoint[j]).squeeze(1) + EDGES * block for block, (i, j) in blocks]
    )
    (first, second), num_superpoints = superpoint[edge_index[:, across]], int(superpoint.max()) + 1
    key = torch.minimum(first, second) * num_superpoints + torch.maximum(first, second)
    key, pair = torch.unique(key, return_inverse=True)
    return across, torch.stack([key // num_superpoints, key % num_superpoints]), pair
