"""Step 1: closed contours of a boundary map, with strengths from region merging (ultrametric contour map)."""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor

from torchjoint.ops._call import call
from torchjoint.ops._checks import check_array


def ultrametric_contours(boundary: Tensor, relief: Tensor) -> Tensor:
    """Close the contours of a boundary map: compute its ultrametric contour map.

    First a watershed divides the image into the basins of ``relief``: steepest descent over the eight neighbours leads
    from each pixel to a lowest pixel (of equally low pixels, to the one that comes first row by row). The region
    boundary of two basins consists of the pairs of neighbouring pixels with one pixel in each basin. The strength of a
    pair is the larger value of ``boundary`` at its two pixels; the strength of a region boundary is the mean over its
    pairs. The two regions with the weakest region boundary are merged, and their boundaries with the same third region
    are joined, until one region is left. The height of a region boundary is the strength at which its two sides become
    one region. Thresholding at a height gives regions with closed contours; a lower threshold subdivides these regions
    (P. Arbeláez et al., "Contour Detection and Hierarchical Image Segmentation", PAMI 2011, with another watershed and
    without orientations).

    Strengths are rounded to 16 bits, so that sums are exact. Of equally weak region boundaries, the one with the
    lowest number is merged. They are numbered by their first pair: pairs to the right come first, then down, down-right
    and up-right. Joined region boundaries keep the lower number.

    Args:
        boundary: ``[H, W]`` float32, strength in [0, 1].
        relief: ``[H, W]`` float32, not NaN; usually the smoothed boundary map, which has fewer basins.

    Returns:
        ``[H, W]`` float32 in [0, 1]: the largest height of the region boundaries at a pixel, 0 if all its neighbours
        are in the same region. Lines are two pixels wide, one pixel on each side; diagonal lines are up to four pixels
        wide. No gradient flows through it.

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
    return cast(Tensor, call(torch.ops.torchjoint.ultrametric_contours.default, boundary, relief))


@torch.library.register_fake("torchjoint::ultrametric_contours")
def _fake(boundary: Tensor, relief: Tensor) -> Tensor:
    return boundary.new_empty(boundary.shape)
