"""Step 6, method learned: regions too small to be told from noise go to whom they touch most.

What neither the judges nor a mask have taken up to the default level would be an object of its own: hundreds of them
in a room.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchjoint import ops
from torchjoint.runtime.groups import first_places
from torchjoint.segments.learned.region_statistics import sum_by

#: A region of fewer points is small. Networks do not detect smaller objects reliably, and leave such remains.
MIN_SIZE = 50


def merges_by_contact(ends: Tensor, size: Tensor, min_size: int, stays: Tensor | None = None) -> Tensor:
    """Merges each small region with the neighbour to which most edges lead, until no small region has a neighbour.

    Of neighbours with equally many edges, the one with the lowest number counts.

    Args:
        ends: [2, C] int64, regions at the two ends of each edge between regions.
        size: [R] int64, points of each region.
        min_size: a group of regions with fewer points is small.
        stays: optional [R] bool; a group with such a region is never small.

    Returns:
        [2, M] int64, for each merge the lowest regions of the two groups; M < R.
    """
    num_regions, group, merges = len(size), torch.arange(len(size)), [ends.new_empty(2, 0)]
    while True:
        is_small = sum_by(group, size, num_regions) < min_size
        if stays is not None:
            is_small[group[stays]] = False
        first, second = torch.cat([group[ends], group[ends.flip(0)]], 1)
        leaves = is_small[first] & (first != second)
        if not leaves.any():
            return torch.cat(merges, 1)
        pair, count = torch.unique(first[leaves] * num_regions + second[leaves], return_counts=True)
        one, other = pair // num_regions, pair % num_regions
        most = torch.zeros(num_regions, dtype=torch.int64).scatter_reduce_(0, one, count, "amax")
        is_most = count == most[one]
        chosen = torch.full((num_regions,), num_regions).scatter_reduce_(0, one[is_most], other[is_most], "amin")
        regions = torch.nonzero(chosen < num_regions).squeeze(1)
        # two that choose each other merge once
        kept = (chosen[chosen[regions]] != regions) | (regions < chosen[regions])
        joined = torch.stack([regions, chosen[regions]])[:, kept]
        merges.append(first_places(group)[joined])
        group = ops.connected_components(joined, num_regions)[group]
