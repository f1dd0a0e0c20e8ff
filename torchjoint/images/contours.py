"""Step 1: from boundary strength, which has gaps, to closed contours."""

from __future__ import annotations

import torch
from torch import Tensor

from torchjoint import ops
from torchjoint.config import ContoursConfig
from torchjoint.images.smoothing import smooth
from torchjoint.runtime.threads import parallel_map


def close_contours(boundaries: Tensor, config: ContoursConfig) -> Tensor:
    """Close the contours of boundary maps, for a segmentation that would leak through a gap of one pixel.

    Each map becomes an ultrametric contour map (:func:`torchjoint.ops.ultrametric_contours`): a stretch of contour is
    as strong as the mean boundary between the regions that it parts. Contours lie between pixels, so the pixels on both
    sides have their strength, to the power of ``exponent``, and all others 0. That is what eq. 2, w_b min(b_i, b_j),
    needs: a step across a contour has its weight, a pixel beside it is joined to its own region by a step inwards,
    which has none, and no broad band of strong boundary becomes a segment of its own.

    Args:
        boundaries: [B, H, W] float32 in [0, 1].

    Returns:
        [B, H, W] float32 in [0, 1]; images are independent of one another, to the bit.

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
        relief = smooth(boundary[None, None], config.smoothing)[0, 0]
        return ops.ultrametric_contours(boundary, relief).pow_(config.exponent)

    return torch.stack(parallel_map(close, boundaries.float()))
