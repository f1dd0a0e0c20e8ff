"""One-to-one matching of the pixels of two maps."""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor

from torchjoint.ops._checks import check_array, check_number


def match_pixels(pred: Tensor, target: Tensor, radius: float) -> tuple[Tensor, Tensor]:
    """Pair the set pixels of two maps that are near each other: each with one at most, and as many as possible.

    First the nearest: for every offset within the radius, by its length, then row, then column, all pairs at that
    offset of which neither is taken yet. Then every pixel of ``pred`` still without a partner, row by row, gets one
    along a shortest alternating path, where there is one (breadth first, offsets in the same order). The number of
    pairs is that of a maximum matching (C. Berge, "Two theorems in graph theory", PNAS 1957). Milliseconds where the
    maps are thin lines, seconds where both are dense and random.

    Args:
        pred: ``[H, W]`` bool.
        target: ``[H, W]`` bool.
        radius: the longest distance of a pair, pixels, Euclidean; finite, >= 0.

    Returns:
        ``pred_matched``, ``target_matched``, both ``[H, W]`` bool: the set pixels that have a partner, the same number
        in both.

    Raises:
        TypeError: an argument of the wrong type or dtype.
        ValueError: a wrong shape or device, a radius that is negative or not finite.

    Example:
        >>> import torch
        >>> pred, target = torch.tensor([[True, True, False, False]]), torch.tensor([[False, False, True, False]])
        >>> match_pixels(pred, target, radius=2)  # two are near enough, one is nearer
        (tensor([[False,  True, False, False]]), tensor([[False, False,  True, False]]))
    """
    check_array("pred", pred, torch.bool, (None, None), "[H, W]")
    check_array("target", target, torch.bool, tuple(pred.shape), f"[H, W] = {list(pred.shape)}")
    check_number("radius", radius, (int, float))
    result = torch.ops.torchjoint.match_pixels.default(pred, target, radius)
    return cast(tuple[Tensor, Tensor], result)


@torch.library.register_fake("torchjoint::match_pixels")
def _fake(pred: Tensor, target: Tensor, radius: float) -> tuple[Tensor, Tensor]:
    return pred.new_empty(pred.shape), pred.new_empty(pred.shape)
