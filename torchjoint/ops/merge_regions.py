"""Step 6, method learned: region merging by mean boundary cost (average linkage)."""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor

from torchjoint.ops._call import call
from torchjoint.ops._checks import check_array, check_edge_index, check_number


def merge_regions(edge_index: Tensor, cost: Tensor, size: Tensor, threshold: float, min_size: int = 0) -> Tensor:
    """Repeatedly merge the two neighbouring regions with the lowest mean boundary cost, up to a threshold.

    The boundary of two regions consists of all edges between them. When two regions merge, their boundaries with the
    same third region become one boundary. Afterwards, regions smaller than ``min_size`` are merged across boundaries in
    the same order, until no such region has a neighbour. This is average-linkage agglomeration (R. Sokal and C.
    Michener, 1958) of the region adjacency graph, as P. Arbeláez et al. (PAMI 2011) merge image regions.

    Costs are rounded to multiples of 2^-20, so that sums are exact (below 2^33 per boundary). Of boundaries with equal
    means, the one with the lowest number is merged first. Boundaries are numbered by their first edges; a joined
    boundary keeps the lower number.

    Args:
        edge_index: ``[2, E]`` int64, region numbers of the two ends. Edges inside a region are ignored. Parallel edges
            all count, so that the mean is over the whole boundary.
        cost: ``[E]`` float32 in [0, 1024].
        size: ``[R]`` int64, size of each region, >= 0, in any unit.
        threshold: largest mean cost of two regions that merge, >= 0.
        min_size: smaller regions are merged with a neighbour; in the unit of ``size``.

    Returns:
        ``[R]`` int64, for each region a label 0, 1, ..., numbered by first appearance. No gradient flows through it.

    Raises:
        TypeError: an argument of the wrong type or dtype.
        ValueError: a wrong shape or device, a number out of range, a NaN.

    Example:
        >>> import torch
        >>> edge_index = torch.tensor([[0, 0, 1, 1], [1, 1, 2, 2]])  # two borders of two edges each
        >>> merge_regions(edge_index, torch.tensor([0.0, 0.2, 0.1, 0.9]), torch.ones(3, dtype=torch.int64), 0.3)
        tensor([0, 0, 1])
    """
    check_edge_index(edge_index)
    check_array("cost", cost, torch.float32, (edge_index.shape[1],), f"[E] = [{edge_index.shape[1]}]")
    check_array("size", size, torch.int64, (None,), "[R]")
    check_number("threshold", threshold, (int, float))
    check_number("min_size", min_size, (int,))
    return cast(
        Tensor,
        call(torch.ops.torchjoint.merge_regions.default, edge_index, cost, size, float(threshold), min_size),
    )


@torch.library.register_fake("torchjoint::merge_regions")
def _fake(edge_index: Tensor, cost: Tensor, size: Tensor, threshold: float, min_size: int) -> Tensor:
    return size.new_empty(size.shape)
