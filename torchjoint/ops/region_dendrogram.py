"""Step 6, method learned: lists the merges of region merging in order."""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor

from torchjoint.ops._call import call
from torchjoint.ops._checks import check_array, check_edge_index, check_number


def region_dendrogram(edge_index: Tensor, cost: Tensor, num_regions: int, threshold: float) -> tuple[Tensor, Tensor]:
    """List the merges that :func:`torchjoint.ops.merge_regions` makes up to a threshold.

    The mean costs of the merges ascend, because each merge has the lowest mean of all boundaries. The merges connect
    the same groups as ``merge_regions`` without ``min_size``. Costs are rounded, and ties are broken, in the same
    way.

    Args:
        edge_index: ``[2, E]`` int64, region numbers of the two ends. Edges inside a region are ignored. Parallel edges
            all count.
        cost: ``[E]`` float32 in [0, 1024].
        num_regions: number of regions R, < 2^31.
        threshold: largest mean cost of two regions that merge, >= 0.

    Returns:
        ``[2, M]`` int64, for each merge the lowest regions a < b of the two groups that merge; ``[M]`` float64, the
        mean cost of their boundary. M < R. No gradient flows through it.

    Raises:
        TypeError: an argument of the wrong type or dtype.
        ValueError: a wrong shape or device, a number out of range, a NaN.

    Example:
        >>> import torch
        >>> edge_index = torch.tensor([[0, 1, 0], [1, 2, 2]])
        >>> region_dendrogram(edge_index, torch.tensor([0.0, 0.25, 0.75]), 3, 1.0)
        (tensor([[0, 0],
                [1, 2]]), tensor([0.0000, 0.5000], dtype=torch.float64))
    """
    check_edge_index(edge_index)
    check_array("cost", cost, torch.float32, (edge_index.shape[1],), f"[E] = [{edge_index.shape[1]}]")
    check_number("num_regions", num_regions, (int,))
    check_number("threshold", threshold, (int, float))
    return cast(
        "tuple[Tensor, Tensor]",
        call(torch.ops.torchjoint.region_dendrogram.default, edge_index, cost, num_regions, float(threshold)),
    )


@torch.library.register_fake("torchjoint::region_dendrogram")
def _fake(edge_index: Tensor, cost: Tensor, num_regions: int, threshold: float) -> tuple[Tensor, Tensor]:
    num_merges = torch.library.get_ctx().new_dynamic_size()
    return edge_index.new_empty((2, num_merges)), cost.new_empty((num_merges,), dtype=torch.float64)
