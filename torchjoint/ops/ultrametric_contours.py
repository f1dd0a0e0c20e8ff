"""Closed contours of a boundary map, as strong as the merging of regions that erases them."""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor

from torchjoint.ops._checks import check_array


def ultrametric_contours(boundary: Tensor, relief: Tensor) -> Tensor:
    """Close the contours of a boundary map, and weigh each by what parts whole regions rather than pixels.

    The image is parted into the basins of ``relief``: from each pixel steepest descent over the eight neighbours leads
    to a lowest pixel (of equally low ones, the one with the smaller number, row by row). Two basins' border are the
    pairs of neighbouring pixels that they part, and its strength is the mean over these of the stronger pixel's
    boundary. The two regions with the weakest border are merged, borders with the same third region joined, and so on
    until one region is left. A border's height is the strength at which its two sides become one region; cutting
    at a height gives regions with closed contours, and lower cuts give parts of these (P. Arbeláez and others, "Contour
    Detection and Hierarchical Image Segmentation", PAMI 2011, with another watershed and without orientation).

    Strengths are rounded to 16 bits, so that sums are exact. Of equally weak borders the one with the lowest number is
    merged; they are numbered by their first pair, all pairs to the right before those down, down-right and up-right,
    and joined ones keep the lower number.

    Args:
        boundary: ``[H, W]`` float32, strength in [0, 1].
        relief: ``[H, W]`` float32, not NaN; usually the boundary, smoothed, which makes for fewer basins.

    Returns:
        ``[H, W]`` float32: the highest border that a pixel lies at, 0 where it has no neighbour in another region.
        Lines are two pixels wide, one on each side, and up to four where they run diagonally. No gradient flows
        through it.

    Raises:
        TypeError: an argument of the wrong type or dtype.
        ValueError: a wrong shape or device, a strength out of range, a NaN.

    Example:
        >>> import torch
        >>> boundary = torch.tensor([[0.0, 0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.5, 0.0, 0.0]])
        >>> ultrametric_contours(boundary, boundary)
        tensor([[0.0000, 0.0000, 0.7500, 0.7500, 0.0000],
                [0.0000, 0.0000, 0.7500, 0.7500, 0.0000]])
    """
    check_array("boundary", boundary, torch.float32, (None, None), "[H, W]")
    check_array("relief", relief, torch.float32, tuple(boundary.shape), f"[H, W] = {list(boundary.shape)}")
    return cast(Tensor, torch.ops.torchjoint.ultrametric_contours.default(boundary.detach(), relief.detach()))


@torch.library.register_fake("torchjoint::ultrametric_contours")
def _fake(boundary: Tensor, relief: Tensor) -> Tensor:
    return boundary.new_empty(boundary.shape)
