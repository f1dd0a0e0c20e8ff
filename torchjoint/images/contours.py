"""Step 1: turns boundary strength, which has gaps, into closed contours."""

from __future__ import annotations

import torch
from torch import Tensor

from torchjoint import ops
from torchjoint.images.smoothing import smooth
from torchjoint.runtime.threads import parallel_map

#: Standard deviation of the blur of the boundaries before the watershed, pixels. Without blur, the noise of a detector
#: makes many tiny regions; a much larger blur rounds corners.
SMOOTHING = 1.0

#: Exponent of a contour's strength. The mean strength of contours of texture is low, so they nearly vanish. With 1 the
#: strength is not changed.
EXPONENT = 3.0


def close_contours(boundaries: Tensor, smoothing: float = SMOOTHING, exponent: float = EXPONENT) -> Tensor:
    """Close the contours of boundary maps, because a segmentation would leak through a gap of one pixel.

    Each map becomes an ultrametric contour map (:func:`torchjoint.ops.ultrametric_contours`): a piece of contour has
    the mean boundary strength between the two regions that it separates. Contours lie between pixels. The pixels on
    both sides get the contour's strength, to the power of ``exponent``; all other pixels get 0. This suits eq. 2,
    w_b min(b_i, b_j): an edge across a contour has the contour's weight. An edge from a contour pixel into its own
    region has weight 0 and joins the pixel to that region. So no broad band of strong boundary becomes its own segment.

    Args:
        boundaries: [B, H, W] float32 in [0, 1].
        smoothing: standard deviation of the blur before the watershed, pixels; more gives fewer and larger regions.
        exponent: applied to a contour's strength; more suppresses weak contours.

    Returns:
        [B, H, W] float32 in [0, 1]. The result of an image does not depend on the other images, bit for bit.

    Raises:
        ValueError: a shape other than [B, H, W], or values out of range.
    """
    if boundaries.ndim != 3:
        raise ValueError(f"boundaries: expected shape [B, H, W], got {list(boundaries.shape)}")
    if boundaries.numel() == 0:
        return boundaries.new_zeros(boundaries.shape, dtype=torch.float32)
    for index, boundary in enumerate(boundaries):
        if not ((boundary >= 0) & (boundary <= 1)).all():
            raise ValueError(f"boundaries: expected numbers in [0, 1], got others in image {index}")

    def close(boundary: Tensor) -> Tensor:
        relief = smooth(boundary[None, None], smoothing)[0, 0]
        return ops.ultrametric_contours(boundary, relief).pow_(exponent)

    return torch.stack(parallel_map(close, boundaries.float()))


def outlines(labels: Tensor) -> Tensor:
    """The outlines of segments, as a boundary map: 1 in pixels beside a pixel of another segment, else 0.

    Args:
        labels: [H, W] integers.

    Returns:
        [H, W] float32.
    """
    boundary = torch.zeros(labels.shape, dtype=torch.bool)
    below, right = labels[1:] != labels[:-1], labels[:, 1:] != labels[:, :-1]
    boundary[1:] |= below
    boundary[:-1] |= below
    boundary[:, 1:] |= right
    boundary[:, :-1] |= right
    return boundary.float()
