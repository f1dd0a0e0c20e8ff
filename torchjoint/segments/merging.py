"""Step 6: region merging, the average-linkage agglomeration of the region adjacency graph.

Repeatedly merges the two regions with the lowest mean boundary cost. Single edges are not reliable: one chain of weak
edges through a soft boundary would join two objects, however strong the rest of the boundary is. So the evidence is
averaged over whole boundaries: each edge of the point graph that crosses a region boundary has a cost, and the mean
cost of these edges counts.

P. Arbelaez, M. Maire, C. Fowlkes, J. Malik, "Contour Detection and Hierarchical Image Segmentation", PAMI 2011, merge
image regions by mean boundary strength in this way. Average linkage in general is due to R. Sokal and C. Michener, "A
Statistical Method for Evaluating Systematic Relationships", University of Kansas Science Bulletin 38, 1958.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchjoint import ops
from torchjoint.runtime.threads import all_threads


def merge(region: Tensor, edge_index: Tensor, cost: Tensor, threshold: float, min_size: int) -> Tensor:
    """Repeatedly merges the two regions with the lowest mean boundary cost, up to the threshold.

    Then each region of fewer than `min_size` points is joined to the neighbour with the lowest mean boundary cost.

    Args:
        region: [N] int64, region of each point, 0 ... R - 1.
        edge_index: [2, E] int64, edges between points; edges inside a region are ignored.
        cost: [E] float32 in [0, 1024].
        threshold: largest mean boundary cost of two regions that merge.
        min_size: points.

    Returns:
        [N] int64 segments 0, 1, ..., numbered by their first regions.
    """
    return merge_sized(region, edge_index, cost, torch.bincount(region), threshold, min_size)


def merge_sized(
    region: Tensor, edge_index: Tensor, cost: Tensor, size: Tensor, threshold: float, min_size: int
) -> Tensor:
    """As :func:`merge`, but `size` [R] int64 gives the size of each region instead of its number of points."""
    with all_threads():
        return ops.merge_regions(region[edge_index], cost, size, threshold, min_size)[region]
