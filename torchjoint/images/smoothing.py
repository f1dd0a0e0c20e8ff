"""Gaussian blur of images (steps 1, 7 and 8)."""

from __future__ import annotations

import kornia
from torch import Tensor


def smooth(images: Tensor, sigma: float) -> Tensor:
    """Gaussian blur of images [B, C, H, W] with replicated image borders; `sigma` in pixels, 0 = none."""
    if sigma == 0:
        return images
    size = 2 * max(1, round(3 * sigma)) + 1
    return kornia.filters.gaussian_blur2d(images, (size, size), (sigma, sigma), border_type="replicate")
