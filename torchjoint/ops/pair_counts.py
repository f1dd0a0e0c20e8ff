"""Pairs of points that are close in an image, counted by what their ends belong to."""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor

from torchjoint.ops._checks import check_array, check_number


def pair_counts(
    u: Tensor, v: Tensor, pixel: Tensor, segment: Tensor, label: Tensor, radius: float
) -> tuple[Tensor, Tensor]:
    """Count the pairs of points at most ``radius`` apart, by the segments and the labels of their ends.

    Pairs of one segment and one label are not counted, which is most of them; neither are pairs within one pixel, and
    points without a segment. No list of pairs is made: memory is needed for the points and for the result.

    Args:
        u, v: ``[M]`` float32, positions, finite.
        pixel: ``[M]`` int64, the pixel a point falls in, >= 0.
        segment: ``[M]`` int64, the segment a point falls in, -1 = none.
        label: ``[M]`` int64, >= 0.
        radius: in the units of ``u`` and ``v``; positive and finite. Two points count at a distance of exactly this.

    Returns:
        ``group`` ``[4, G]`` int64, rows lower segment, higher segment, lower label, higher label, in ascending order;
        and ``count`` ``[G]`` int64, how many pairs are of each group.

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
    result = torch.ops.torchjoint.pair_counts.default(u.detach(), v.detach(), pixel, segment, label, float(radius))
    return cast(tuple[Tensor, Tensor], result)


@torch.library.register_fake("torchjoint::pair_counts")
def _fake(u: Tensor, v: Tensor, pixel: Tensor, segment: Tensor, label: Tensor, radius: float) -> tuple[Tensor, Tensor]:
    count = torch.library.get_ctx().new_dynamic_size()
    return u.new_empty(4, count, dtype=torch.int64), u.new_empty(count, dtype=torch.int64)
