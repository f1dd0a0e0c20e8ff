"""Step 6, method learned: regions too small to be told from noise go to whom they touch most.

What neither the members nor a mask have taken up to the default level would be an object of its own: hundreds of them
in a room.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchjoint import ops
from torchjoint.runtime.groups import first_places
from torchjoint.segments.learned.region_statistics import sum_by

#: A region of fewer points is small. The first number is for clouds alone, and for masks, of which networks leave such
#: remains; the second for images, whose contours tell small things from remains.
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
        pair, row = torch.unique(first[leaves] * num_regions + second[leaves], return_inverse=True)
        num_edges = sum_by(row, count[leaves], len(pair))
        one, other = pair // num_regions, pair % num_regions
        most = torch.zeros(num_regions, dtype=torch.int64).scatter_reduce_(0, one, num_edges, "amax")
        is_most = num_edges == most[one]
        chosen = torch.full((num_regions,), num_regions).scatter_reduce_(0, one[is_most], other[is_most], "amin")
        regions = torch.nonzero(chosen < num_regions).squeeze(1)
        # two that choose each other merge once
        kept = (chosen[chosen[regions]] != regions) | (regions < chosen[regions])
        joined = torch.stack([regions, chosen[regions]])[:, kept]
        merges.append(first_places(group)[joined])
        group = ops.connected_components(joined, num_regions)[group]
