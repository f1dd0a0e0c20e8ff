"""Step 6, method learned: what masks of networks say: they cut superpoints, merge and move them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchjoint import ops
from torchjoint.ops.internal import mask_merges
from torchjoint.runtime.groups import best_of_groups, find, first_places
from torchjoint.runtime.threads import parallel_map
from torchjoint.scene import Hierarchy
from torchjoint.segments.learned.region_statistics import sum_by
from torchjoint.segments.learned.small_regions import MIN_SIZE, MIN_SIZE_IN_IMAGES
from torchjoint.segments.learned.superpoint_graph import MaskCounts, masks_of_superpoints, pairs_in_one_group
from torchjoint.views.observations import Observation

# These numbers were chosen on generated rooms, table-tops, shelves and kitchens with perfect, SAM-like and hard masks.
# None of these scenes is used for scores.

#: Weight of a vote of two points in different masks; two points in one mask have weight 1. Networks split objects more
#: often than they join them.
APART_WEIGHT = 0.6
#: Weight of the model's probability, in frames that see both regions completely: the smallest one, the one of the first
#: merging, and the factor on the masks' noise, which is the share of votes against the regions of the first merging.
LEAST_PRIOR_WEIGHT, FIRST_PRIOR_WEIGHT, PRIOR_WEIGHT_OF_NOISE = 0.05, 0.1, 2.0
#: A mask contains a region if at least this many of the region's points lie in it. Fewer are mostly seen through a gap.
MIN_POINTS = 3
#: A mask confirms a region if their overlap (intersection over union of visible points) is at least this.
CONFIRMED = 0.5


@dataclass(frozen=True)
class MaskLinkage:
    """Merges regions by masks.

    Attributes:
        masks: counts of the points of each superpoint in each mask.
        size: [P] int64, points of each superpoint.
        prior_weight: weight of the model's probability, in frames.
        keeps_outlines: whether what a mask confirms stays apart from what another mask confirms, and from what most
            views show without a mask: "no mask" beside a mask says that its thing ends there.
    """

    masks: MaskCounts
    size: Tensor
    prior_weight: float = FIRST_PRIOR_WEIGHT
    keeps_outlines: bool = False

    @classmethod
    def of(cls, masks: MaskCounts | None, size: Tensor) -> MaskLinkage | None:
        """The linkage of superpoints with sizes [P]; None if there are no masks."""
        return None if masks is None else cls(masks, size.long())

    def grouped(self, *groups: Tensor) -> MaskLinkage:
        """The linkage of disjoint copies as :meth:`SuperpointGraph.grouped`; each copy has masks and frames of its own.

        Args:
            groups: for each copy [P] int64, group of each superpoint, 0 ... G - 1.
        """
        masks, sizes, tables, start = self.masks, [], [], 0
        num_frames = int(masks.in_frame[1].max()) + 1 if masks.in_frame.numel() else 1
        for number, group in enumerate(groups):
            in_mask, in_frame = masks.of_regions(group)
            for rows, each in ((in_mask, len(masks.weight)), (in_frame, num_frames)):
                rows[:2] += torch.tensor([[start], [number * each]])
            bare = torch.stack([group[masks.bare[0]] + start, masks.bare[1]])
            tables.append((in_mask, in_frame, masks.weight, masks.frame_of_mask + number * num_frames, bare))
            sizes.append(sum_by(group, self.size, int(group.max()) + 1))
            start += len(sizes[-1])
        joined = MaskCounts(*(torch.cat(parts, -1) for parts in zip(*tables, strict=True)))
        return replace(self, masks=joined, size=torch.cat(sizes))

    def merges(
        self, of_superpoint: Tensor, ends: Tensor, cost: Tensor, count: Tensor, threshold: float
    ) -> tuple[Tensor, Tensor]:
        """As :func:`torchjoint.ops.region_dendrogram`, with masks.

        Args:
            of_superpoint: [P] int64, region of each superpoint, 0 ... R - 1.
            ends: [2, B] int64, the two regions of each boundary.
            cost: [B] float32, the model's probability that they belong to different objects.
            count: [B] int64, edges of the boundary.
            threshold: largest cost of two regions that merge.
        """
        if self.keeps_outlines:
            confirmed = self.confirmed(of_superpoint)
            apart = (confirmed[ends] & (confirmed | self.masks.unmasked(of_superpoint))[ends.flip(0)]).any(0)
            ends, cost, count = ends[:, ~apart], cost[~apart], count[~apart]
        return mask_merges(ends, cost, count, *self._tables(of_superpoint), APART_WEIGHT, self.prior_weight, threshold)

    def merges_far(
        self, of_superpoint: Tensor, ends: Tensor, cost: Tensor, count: Tensor, threshold: float
    ) -> tuple[Tensor, Tensor]:
        """As `merges`; regions in one mask may merge even if they do not touch, as over an edge of cost 1."""
        far, num_regions = self.far_pairs(of_superpoint), int(of_superpoint.max()) + 1
        key, known = (pairs[0] * num_regions + pairs[1] for pairs in (far, ends))
        far = far[:, ~torch.isin(key, known)]
        one = torch.ones(far.shape[1], dtype=torch.int64)
        ends, cost, count = torch.cat([ends, far], 1), torch.cat([cost, one.float()]), torch.cat([count, one])
        return self.merges(of_superpoint, ends, cost, count, threshold)

    def far_pairs(self, of_superpoint: Tensor) -> Tensor:
        """Pairs of regions that lie in one mask, whether or not they touch: [2, B] int64, a < b, ascending."""
        region, mask, count = self.masks.of_regions(of_superpoint)[0]
        enough = count >= MIN_POINTS
        return pairs_in_one_group(region[enough], mask[enough], int(of_superpoint.max()) + 1)

    def merges_of_small(
        self, of_superpoint: Tensor, ends: Tensor, cost: Tensor, count: Tensor, _: float = math.inf
    ) -> tuple[Tensor, Tensor]:
        """As `merges`, without threshold: small regions in masks join a neighbour, unless a mask confirms them.

        Regions that most views show without a mask stay.
        """
        stays = self.confirmed(of_superpoint) | self.masks.unmasked(of_superpoint)
        masks = (*self._tables(of_superpoint), APART_WEIGHT, self.prior_weight)
        return mask_merges(ends, cost, count, *masks, math.inf, stays, MIN_SIZE)

    def confirmed(self, of_superpoint: Tensor) -> Tensor:
        """Whether a mask confirms each region, [R] bool."""
        size, in_mask, in_frame, *_ = self._tables(of_superpoint)
        best = torch.zeros(len(size), dtype=torch.float64)
        best.scatter_reduce_(0, in_mask[0], overlaps(self.masks, in_mask, in_frame), "amax")
        return best >= CONFIRMED

    def stays_small(self, of_superpoint: Tensor) -> Tensor:
        """Whether each region stays though it is small, [R] bool: a mask confirms it, or it is a small thing in images.

        That is one of enough points that most views show without a mask, so that it is no remain of a mask.
        """
        size = sum_by(of_superpoint, self.size, int(of_superpoint.max()) + 1)
        return self.confirmed(of_superpoint) | (self.masks.unmasked(of_superpoint) & (size >= MIN_SIZE_IN_IMAGES))

    def _tables(self, of_superpoint: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        size = sum_by(of_superpoint, self.size, int(of_superpoint.max()) + 1)
        return size, *self.masks.of_regions(of_superpoint), self.masks.weight, self.masks.frame_of_mask

    def calibrated(self, of_superpoint: Tensor) -> MaskLinkage:
        """A copy whose prior weight grows with the share of votes against the given regions.

        Args:
            of_superpoint: [P] int64, regions that were merged by these masks.
        """
        size, in_mask, in_frame, *_ = self._tables(of_superpoint)
        share = shares_against(self.masks, in_mask, in_frame, len(size))
        known = ~share.isnan() & ~self.masks.unmasked(of_superpoint)  # the others' few points in masks are strays
        noise = float((share[known] * size[known]).sum() / size[known].sum()) if known.any() else 0.0
        return replace(self, prior_weight=max(LEAST_PRIOR_WEIGHT, PRIOR_WEIGHT_OF_NOISE * noise))


def shares_against(masks: MaskCounts, in_mask: Tensor, in_frame: Tensor, num_regions: int) -> Tensor:
    """The share of the votes inside each region that are against one object: [R] float64, NaN without votes.

    Arguments as those of :func:`overlaps`.
    """
    region, mask, count = in_mask
    weight = masks.weight[mask]  # whole numbers: sums in any order are the same
    together = sum_by(region, weight * count * count, num_regions)
    total = sum_by(region, weight * count * _seen_with(masks, in_mask, in_frame), num_regions)
    return 1 - together.double() / total  # 0 / 0 is NaN


def overlaps(masks: MaskCounts, in_mask: Tensor, in_frame: Tensor) -> Tensor:
    """The overlap (intersection over union) of each row (region, mask, points), in points that the frame sees.

    Args:
        masks: the masks.
        in_mask: [3, K] int64, and
        in_frame: [3, J] int64, as :meth:`MaskCounts.of_regions` gives them.

    Returns:
        [K] float64.
    """
    _, mask, count = in_mask
    in_whole_mask = sum_by(mask, count, len(masks.weight))[mask]
    return count.double() / (_seen_with(masks, in_mask, in_frame) + in_whole_mask - count)


def _seen_with(masks: MaskCounts, in_mask: Tensor, in_frame: Tensor) -> Tensor:
    """For each row (region, mask, points): how many points of the region the mask's frame sees."""
    region, mask, _ = in_mask
    num_frames = int(in_frame[1].max()) + 1 if in_frame.numel() else 1  # the last of them may have no masks
    view, order = (in_frame[0] * num_frames + in_frame[1]).sort()
    place, _ = find(view, region * num_frames + masks.frame_of_mask[mask])
    return in_frame[2][order][place]


# These numbers were chosen on generated rooms, table-tops and shelves with perfect, SAM-like and hard masks. None of
# these scenes is used for scores.

#: A superpoint is cut if more than this share of the votes of its pairs of points is against one object.
MIXED = 0.1
#: Weight, in frames, of the assumption that the points of one superpoint belong together.
PRIOR_WEIGHT = 0.1
#: Largest cost of two parts that merge again.
THRESHOLD = 0.5
#: Largest number of frames per superpoint: those that see most of it. All frames of all points would take gigabytes.
MAX_FRAMES = 32


def cut_by_masks(superpoint: Tensor, edge_index: Tensor, observations: Sequence[Observation]) -> Tensor:
    """Cuts the superpoints whose points lie in different masks.

    The points of such a superpoint merge again from single points, as regions do
    (:func:`torchjoint.ops.internal.mask_merges`). So a superpoint is cut only where the masks of most frames agree;
    single wrong outlines do not cut.

    Args:
        superpoint: [N] int64, 0 ... P - 1.
        edge_index: [2, E] int64, edges of the point graph.
        observations: the frames; those without masks do not count.

    Returns:
        [N] int64 superpoints, numbered by first appearance; each lies inside one of the given superpoints.
    """
    masks = masks_of_superpoints(superpoint, observations)
    if masks is None:
        return superpoint
    num_superpoints = int(superpoint.max()) + 1
    single = (shares_against(masks, masks.in_mask, masks.in_frame, num_superpoints) > MIXED)[superpoint]
    # The points of mixed superpoints are regions of their own; each other superpoint is one region, named by its first
    # point.
    first = first_places(superpoint, num_superpoints)[superpoint]
    region = torch.unique(torch.where(single, torch.arange(len(superpoint)), first), return_inverse=True)[1]
    i, j = edge_index
    ends = region[edge_index[:, single[i] & (superpoint[i] == superpoint[j])]]
    counts = _frames_that_see_most(masks.in_frame, num_superpoints, len(observations))
    of_points = masks_of_superpoints(region, observations, lambda frame, point: counts[frame, superpoint[point]])
    joined = _merges_of_parts(ends, torch.bincount(region), of_points)
    return ops.connected_components(joined, int(region.max()) + 1)[region]


def _frames_that_see_most(in_frame: Tensor, num_superpoints: int, num_frames: int) -> Tensor:
    """The MAX_FRAMES frames that see most points of each superpoint; ties: the first frames. [F, P] bool."""
    superpoint, frame, num_points = in_frame[:, torch.argsort(in_frame[1], stable=True)]
    order = torch.argsort(num_points, descending=True, stable=True)
    order = order[torch.argsort(superpoint[order], stable=True)]
    count = torch.bincount(superpoint, minlength=num_superpoints)
    rank = torch.arange(len(order)) - (count.cumsum(0) - count)[superpoint[order]]
    chosen = order[rank < MAX_FRAMES]
    most = torch.zeros(num_frames, num_superpoints, dtype=torch.bool)
    most[frame[chosen], superpoint[chosen]] = True
    return most


def _merges_of_parts(edge_index: Tensor, size: Tensor, masks: MaskCounts | None) -> Tensor:
    """The merges [2, M] of regions that the masks do not separate; `size` [R] is their number of points."""
    assert masks is not None  # the observations have masks
    tables = (*masks.of_regions(torch.arange(len(size))), masks.weight, masks.frame_of_mask)
    prior, one = torch.zeros(edge_index.shape[1], dtype=torch.float32), torch.ones_like(edge_index[0])
    return mask_merges(edge_index, prior, one, size, *tables, APART_WEIGHT, PRIOR_WEIGHT, THRESHOLD)[0]


#: Number of frames whose points are held in memory at a time.
BATCH = 32


def move_to_majority(
    hierarchy: Hierarchy, edge_index: Tensor, masks: MaskCounts, observations: Sequence[Observation]
) -> Hierarchy:
    """Moves points to the regions of the masks in which most frames see them.

    Each mask belongs to the region of the default level with which it overlaps best. A point moves if more than half of
    the frames with masks that see it show it in masks of one other region, and if it has a neighbour in that region.
    It joins the superpoint of this neighbour; if there are several, the one with the lowest number counts. So all
    levels stay nested. No superpoint loses all its points.

    Args:
        hierarchy: the superpoints and their merges.
        edge_index: [2, E] int64, edges of the point graph.
        masks: the masks in which the superpoints lie.
        observations: the frames from which `masks` was made.
    """
    of_superpoint = hierarchy.segments_of_superpoints(hierarchy.default)
    region = of_superpoint[hierarchy.superpoint]
    wanted = _wanted_regions(region, _best_regions(masks, of_superpoint), observations)
    ends = torch.cat([edge_index, edge_index.flip(0)], 1)
    one, other = ends[:, (wanted[ends[0]] >= 0) & (wanted[ends[0]] == region[ends[1]])]
    stays = torch.arange(len(region))
    source = stays.scatter_reduce(0, one, other, "amin", include_self=False)
    # If points stay to keep their superpoint, another superpoint that would have received them may be lost: test again.
    while (is_lost := torch.bincount(hierarchy.superpoint[source], minlength=hierarchy.num_superpoints) == 0).any():
        source = torch.where(is_lost[hierarchy.superpoint], stays, source)
    moved = hierarchy.transferred(source)[0]
    if moved.votes is None:
        return moved
    return replace(moved, votes=moved.votes._replace(size=torch.bincount(moved.superpoint)))


def _wanted_regions(region: Tensor, region_of_mask: Tensor, observations: Sequence[Observation]) -> Tensor:
    """For each point, another region in whose masks more than half of its frames show it: [N] int64, -1 = none.

    Args:
        region: [N] int64, region of each point, 0 ... R - 1.
        region_of_mask: [M] int64, -1 = none; the masks are numbered frame by frame.
        observations: the frames; those without masks do not count.
    """
    num_regions = int(region.max()) + 1
    views, first = torch.zeros_like(region), 0
    votes = [torch.empty(0, dtype=torch.int64)]
    for start in range(0, len(observations), BATCH):
        for point, mask, num_masks in parallel_map(_smallest_masks, observations[start : start + BATCH]):
            views[point] += 1
            point, chosen = point[mask >= 0], region_of_mask[first + mask[mask >= 0]]
            elsewhere = (chosen >= 0) & (chosen != region[point])
            votes.append(point[elsewhere] * num_regions + chosen[elsewhere])
            first += num_masks
    key, count = torch.unique(torch.cat(votes), return_counts=True)
    most = 2 * count > views[key // num_regions]  # so at most one region per point
    wanted = torch.full_like(region, -1)
    wanted[key[most] // num_regions] = key[most] % num_regions
    return wanted


def _smallest_masks(seen: Observation) -> tuple[Tensor, Tensor, int]:
    """The visible points [V], the smallest mask in which each lies, -1 = none, and the number of masks of the frame."""
    if seen.masks is None:
        nothing = torch.empty(0, dtype=torch.int64)
        return nothing, nothing, 0
    smallest = seen.masks.smallest(torch.ones(len(seen.masks), dtype=torch.bool))
    visible = seen.visible
    return visible.point, smallest[seen.masks.atom[visible.row, visible.column].long()], len(seen.masks)


def _best_regions(masks: MaskCounts, of_superpoint: Tensor) -> Tensor:
    """The region that overlaps best with each mask, of several the lowest: [M] int64, -1 = none."""
    in_mask, in_frame = masks.of_regions(of_superpoint)
    region, mask, _ = in_mask
    return best_of_groups(mask, region, overlaps(masks, in_mask, in_frame), len(masks.weight))[0]
