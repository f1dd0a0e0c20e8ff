"""Step 6, with masks: merges regions by the agreement of masks, and lists the merges in order."""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor

from torchjoint.ops._call import call
from torchjoint.ops._checks import check_array, check_edge_index, check_number

#: The weight of a mask that is fully trusted. Weights are whole numbers, so that all sums are exact.
WEIGHT_UNIT = 256


def mask_merges(
    edge_index: Tensor,
    cost: Tensor,
    size: Tensor,
    in_mask: Tensor,
    in_frame: Tensor,
    weight: Tensor,
    frame_of_mask: Tensor,
    apart_weight: float,
    prior_weight: float,
    threshold: float,
    stays: Tensor | None = None,
    min_size: int = 0,
) -> tuple[Tensor, Tensor]:
    """Repeatedly merge the two adjacent regions with the lowest cost, up to a threshold, and list the merges.

    For two regions with n and n' points, consider all pairs of points, one of each region, that one frame sees. A mask
    of weight s that contains both points adds s to A. A mask that contains one of them adds s / 2 to D. A mask with
    neither adds nothing. With the mean prior p over the edges between the two regions, the cost of their boundary is

        (w D / (n n') + k p) / ((A + w D) / (n n') + k)

    So k is a number of views: the prior has the weight of k frames that see both regions completely. A merged region
    has the points of both. Of equal costs, the boundary that comes first in ``edge_index`` is merged. All sums are
    exact, so the order of the columns of ``in_mask`` and ``in_frame`` does not change the result.

    Args:
        edge_index: ``[2, E]`` int64, region numbers of the two ends. Edges inside a region are ignored. Parallel edges
            all count.
        cost: ``[E]`` float32 in [0, 1], prior of each edge; rounded to multiples of 2^-20.
        size: ``[R]`` int64 > 0, points of each region.
        in_mask: ``[3, I]`` int64: region, mask, and the number of the region's points in the mask.
        in_frame: ``[3, J]`` int64: region, frame, and the number of the region's points that the frame sees.
        weight: ``[M]`` int64 in [0, WEIGHT_UNIT], weight of each mask.
        frame_of_mask: ``[M]`` int64.
        apart_weight: w >= 0. Masks of parts are more common than masks of several objects, so w < 1.
        prior_weight: k > 0, frames.
        threshold: largest cost of two regions that merge, >= 0.
        stays: optional ``[R]`` bool, regions that are never small.
        min_size: if it is not 0, two groups of regions merge only if one of them is small: it has fewer points than
            this, and contains no region of ``stays``.

    Returns:
        ``[2, M']`` int64, for each merge the lowest regions a < b of the two groups that merge; ``[M']`` float64, the
        cost of their boundary. M' < R. No gradient flows through it.

    Raises:
        TypeError: an argument of the wrong type or dtype.
        ValueError: a wrong shape or device, a number out of range, a NaN, a region with more points in a mask than in
            its frame.

    Example:
        >>> import torch
        >>> edge_index = torch.tensor([[0, 1], [1, 2]])
        >>> in_mask = torch.tensor([[0, 1, 2], [0, 0, 1], [5, 5, 5]])  # 0 and 1 lie in mask 0, 2 lies in mask 1
        >>> in_frame = torch.tensor([[0, 1, 2], [0, 0, 0], [5, 5, 5]])
        >>> sizes, weight = torch.full((3,), 5), torch.full((2,), WEIGHT_UNIT)
        >>> mask_merges(edge_index, torch.zeros(2), sizes, in_mask, in_frame, weight, torch.tensor([0, 0]), 1, 0.1, 0.5)
        (tensor([[0],
                [1]]), tensor([0.], dtype=torch.float64))
    """
    check_edge_index(edge_index)
    check_array("cost", cost, torch.float32, (edge_index.shape[1],), f"[E] = [{edge_index.shape[1]}]")
    check_array("size", size, torch.int64, (None,), "[R]")
    check_array("in_mask", in_mask, torch.int64, (3, None), "[3, I]")
    check_array("in_frame", in_frame, torch.int64, (3, None), "[3, J]")
    check_array("weight", weight, torch.int64, (None,), "[M]")
    check_array("frame_of_mask", frame_of_mask, torch.int64, (len(weight),), f"[M] = [{len(weight)}]")
    check_number("apart_weight", apart_weight, (int, float))
    check_number("prior_weight", prior_weight, (int, float))
    check_number("threshold", threshold, (int, float))
    check_number("min_size", min_size, (int,))
    if stays is None:
        stays = torch.zeros(len(size), dtype=torch.bool)
    check_array("stays", stays, torch.bool, (len(size),), f"[R] = [{len(size)}]")
    return cast(
        "tuple[Tensor, Tensor]",
        call(torch.ops.torchjoint.mask_merges.default,
            edge_index, cost, size, in_mask, in_frame, weight, frame_of_mask, float(apart_weight),
            float(prior_weight), float(threshold), stays, min_size,
        ),
    )  # fmt: skip


@torch.library.register_fake("torchjoint::mask_merges")
def _fake(edge_index: Tensor, cost: Tensor, *_: object) -> tuple[Tensor, Tensor]:
    num_merges = torch.library.get_ctx().new_dynamic_size()
    return edge_index.new_empty((2, num_merges)), cost.new_empty((num_merges,), dtype=torch.float64)
