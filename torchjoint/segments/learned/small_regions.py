"""Step 6, method learned: regions too small to be told from noise go to whom they touch most.

What neither the members nor a mask have taken up to the default level would be an object of its own: hundreds of them
in a room.
"""

import torch
from torch import Tensor

from torchjoint import ops
from torchjoint.runtime.groups import best_of_groups, counted_pairs, first_places
from torchjoint.segments.learned.region_statistics import sum_by

#: A region of fewer points is small. The first number is for clouds alone, and for what lies in masks, of which
#: networks leave such remains; the second for what else images show: their contours tell small things from remains.
MIN_SIZE, MIN_SIZE_IN_IMAGES = 50, 15


def merges_by_contact(
    ends: Tensor, count: Tensor, size: Tensor, stays: Tensor | None = None, min_size: int = MIN_SIZE
) -> Tensor:
    """Merges each small region with the neighbour to which most edges lead, until no small region has a neighbour.

    Of neighbours with equally many edges, the one with the lowest number counts.

    Args:
        ends: [2, B] int64, the two regions of each boundary.
        count: [B] int64, edges of each boundary.
        size: [R] points of each region.
        stays: optional [R] bool; a group with such a region is never small.
        min_size: points; smaller regions are small.

    Returns:
        [2, M] int64, for each merge the lowest regions of the two groups; M < R.
    """
    num_regions, group, merges = len(size), torch.arange(len(size)), [ends.new_empty(2, 0)]
    ends, count = torch.cat([ends, ends.flip(0)], 1), count.repeat(2)
    while True:
        is_small = sum_by(group, size, num_regions) < min_size
        if stays is not None:
            is_small[group[stays]] = False
        first, second = group[ends]
        leaves = is_small[first] & (first != second)
        if not leaves.any():
            return torch.cat(merges, 1)
        one, other, num_edges = counted_pairs(first[leaves], second[leaves], count[leaves])
        chosen, _ = best_of_groups(one, other, num_edges, num_regions)
        regions = torch.nonzero(chosen >= 0).squeeze(1)
        # two that choose each other merge once
        kept = (chosen[chosen[regions]] != regions) | (regions < chosen[regions])
        joined = torch.stack([regions, chosen[regions]])[:, kept]
        merges.append(first_places(group)[joined])
        group = ops.connected_components(joined, num_regions)[group]
