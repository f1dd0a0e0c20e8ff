"""Step 6, method learned, with masks of a network: with more views, masks outweigh the model's probability.

Each pair of points that a frame sees is a vote: for one object if both lie in one mask, against it if a mask has only
one of them. Votes are summed over all frames and over all pairs of points of two regions. So a mask that splits an
object, joins two objects or misses one only shifts a mean (:func:`torchjoint.ops.internal.mask_merges`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchjoint.ops.internal import mask_merges
from torchjoint.runtime.sorted_groups import find, members_of_groups
from torchjoint.segments.learned.mask_counts import MaskCounts
from torchjoint.segments.learned.small_regions import MIN_SIZE
from torchjoint.segments.learned.summaries import sum_by

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
        masks: counts of the points of each piece in each mask.
        size: [P] int64, points of each piece.
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
        """The linkage of pieces with sizes [P]; None if there are no masks."""
        return None if masks is None else cls(masks, size.long())

    def merges(self, of_piece: Tensor, ends: Tensor, cost: Tensor, threshold: float) -> tuple[Tensor, Tensor]:
        """As :func:`torchjoint.ops.region_dendrogram`, with masks.

        Args:
            of_piece: [P] int64, region of each piece, 0 ... R - 1.
            ends: [2, C] int64, regions at the two ends of each edge.
            cost: [C] float32, the model's probability that the ends belong to different objects.
            threshold: largest cost of two regions that merge.
        """
        if self.keeps_outlines:
            confirmed = self.confirmed(of_piece)
            apart = (confirmed[ends] & (confirmed | self._without_masks(of_piece))[ends.flip(0)]).any(0)
            ends, cost = ends[:, ~apart], cost[~apart]
        return mask_merges(ends, cost, *self._tables(of_piece), APART_WEIGHT, self.prior_weight, threshold)

    def far_pairs(self, of_piece: Tensor) -> Tensor:
        """Pairs of regions that lie in one mask, whether or not they touch: [2, B] int64, a < b, ascending."""
        num_regions = int(of_piece.max()) + 1
        region, mask, count = self.masks.of_regions(of_piece)[0]
        region, mask = region[count >= MIN_POINTS], mask[count >= MIN_POINTS]
        order = torch.argsort(mask, stable=True)
        region, mask = region[order], mask[order]
        # Each row meets all rows of its mask.
        first, second = members_of_groups(torch.bincount(mask, minlength=len(self.masks.weight)), mask)
        one, other = region[first], region[second]
        key = torch.unique((one * num_regions + other)[one < other])
        return torch.stack([key // num_regions, key % num_regions])

    def crumbs(self, of_piece: Tensor, ends: Tensor, cost: Tensor) -> tuple[Tensor, Tensor]:
        """The merges with a neighbour of small regions in masks, unless a mask confirms them; arguments as `merges`.

        Regions that most views show without a mask stay.
        """
        stays = self.confirmed(of_piece) | self._without_masks(of_piece)
        return mask_merges(
            ends, cost, *self._tables(of_piece), APART_WEIGHT, self.prior_weight, math.inf, stays, MIN_SIZE
        )

    def confirmed(self, of_piece: Tensor) -> Tensor:
        """Whether a mask confirms each region, [R] bool."""
        size, in_mask, in_frame, *_ = self._tables(of_piece)
        best = torch.zeros(len(size), dtype=torch.float64)
        best.scatter_reduce_(0, in_mask[0], overlaps(self.masks, in_mask, in_frame), "amax")
        return best >= CONFIRMED

    def _without_masks(self, of_piece: Tensor) -> Tensor:
        """Whether most views show a region without a mask, [R] bool."""
        size, in_mask, in_frame, *_ = self._tables(of_piece)
        in_masks, in_view = (sum_by(table[0], table[2], len(size)) for table in (in_mask, in_frame))
        return 2 * in_masks < in_view

    def _tables(self, of_piece: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        size = sum_by(of_piece, self.size, int(of_piece.max()) + 1)
        return size, *self.masks.of_regions(of_piece), self.masks.weight, self.masks.frame_of_mask

    def calibrated(self, of_piece: Tensor) -> MaskLinkage:
        """A copy whose prior weight grows with the share of votes against the given regions.

        Args:
            of_piece: [P] int64, regions that were merged by these masks.
        """
        size, in_mask, in_frame, *_ = self._tables(of_piece)
        share = shares_against(self.masks, in_mask, in_frame, len(size))
        size = size[~share.isnan()]
        noise = float((share[~share.isnan()] * size).sum() / size.sum()) if len(size) else 0.0
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
    num_frames = int(masks.frame_of_mask.max()) + 1 if len(masks.frame_of_mask) else 1
    view, order = (in_frame[0] * num_frames + in_frame[1]).sort()
    place, _ = find(view, region * num_frames + masks.frame_of_mask[mask])
    return in_frame[2][order][place]
