"""Evaluation of step 1: one-to-one matching of the set pixels of two boundary maps."""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor

from torchjoint.ops._call import call
from torchjoint.ops._checks import check_array, check_number


def match_pixels(pred: Tensor, target: Tensor, radius: float) -> tuple[Tensor, Tensor]:
    """Match the set pixels of two maps one to one, within a radius; the number of pairs is the largest possible.

    First a greedy pass pairs the nearest pixels. It takes the offsets within the radius in the order of length, row,
    column, and pairs all pixels with this offset that are both still free. Then each free pixel of ``pred``, row by
    row, gets a partner along a shortest alternating path, if one exists (breadth first, offsets in the same order). The
    result is a maximum matching (C. Berge, "Two theorems in graph theory", PNAS 1957). It takes milliseconds for maps
    of thin lines, and seconds if both maps are dense and random.

    Args:
        pred: ``[H, W]`` bool.
        target: ``[H, W]`` bool.
        radius: largest Euclidean distance of a pair, pixels; finite, >= 0.

    Returns:
        ``pred_matched``, ``target_matched``, both ``[H, W]`` bool: the set pixels that have a partner; both maps have
        the same number of them.

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
    result = call(torch.ops.torchjoint.match_pixels.default, pred, target, radius)
    return cast(tuple[Tensor, Tensor], result)


@torch.library.register_fake("torchjoint::match_pixels")
def _fake(pred: Tensor, target: Tensor, radius: float) -> tuple[Tensor, Tensor]:
    return pred.new_empty(pred.shape), pred.new_empty(pred.shape)
