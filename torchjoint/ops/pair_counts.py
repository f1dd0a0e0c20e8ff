"""Step 7, method cuts: counts pairs of points that are close in an image, by segments and labels (eq. 7-9)."""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor

from torchjoint.ops._call import call
from torchjoint.ops._checks import check_array, check_number


def pair_counts(
    u: Tensor, v: Tensor, pixel: Tensor, segment: Tensor, label: Tensor, radius: float
) -> tuple[Tensor, Tensor]:
    """Count the pairs of points at most ``radius`` apart, grouped by the segments and labels of the two points.

    Pairs with equal segments and equal labels (most pairs) are not counted. Neither are pairs within one pixel, and
    points without a segment. The pairs are not stored: only the points and the result need memory.

    Args:
        u, v: ``[M]`` float32, positions, finite.
        pixel: ``[M]`` int64, the pixel that contains each point, >= 0.
        segment: ``[M]`` int64, the segment that contains each point, -1 = none.
        label: ``[M]`` int64, label of each point, >= 0.
        radius: in the units of ``u`` and ``v``; positive and finite. A distance of exactly ``radius`` counts.

    Returns:
        ``group`` ``[4, G]`` int64, rows lower segment, higher segment, lower label, higher label, in ascending order;
        and ``count`` ``[G]`` int64, the number of pairs in each group.

    Raises:
        TypeError: an argument of the wrong type or dtype.
        ValueError: a wrong shape or device, a position that is not finite, a number out of range.

    Example:
        >>> import torch
        >>> u, v = torch.tensor([0.0, 1.0, 2.0, 9.0]), torch.zeros(4)
        >>> segment, label = torch.tensor([0, 0, 1, 1]), torch.tensor([5, 6, 6, 6])
        >>> group, count = pair_counts(u, v, torch.arange(4), segment, label, radius=2.0)
        >>> group.T, count
        (tensor([[0, 0, 5, 6],
                 [0, 1, 5, 6],
                 [0, 1, 6, 6]]), tensor([1, 1, 1]))
    """
    check_array("u", u, torch.float32, (None,), "[M]")
    for name, value, dtype in (
        ("v", v, torch.float32),
        ("pixel", pixel, torch.int64),
        ("segment", segment, torch.int64),
        ("label", label, torch.int64),
    ):
        check_array(name, value, dtype, (u.shape[0],), f"[M] = [{u.shape[0]}]")
    check_number("radius", radius, (int, float))
    result = call(torch.ops.torchjoint.pair_counts.default, u, v, pixel, segment, label, float(radius))
    return cast(tuple[Tensor, Tensor], result)


@torch.library.register_fake("torchjoint::pair_counts")
def _fake(u: Tensor, v: Tensor, pixel: Tensor, segment: Tensor, label: Tensor, radius: float) -> tuple[Tensor, Tensor]:
    count = torch.library.get_ctx().new_dynamic_size()
    return u.new_empty(4, count, dtype=torch.int64), u.new_empty(count, dtype=torch.int64)
