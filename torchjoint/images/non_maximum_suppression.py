"""Step 1: non-maximum suppression, which reduces thick boundaries to thin lines."""

from __future__ import annotations

import kornia
import torch
from torch import Tensor

from torchjoint.runtime.threads import one_thread_per_operation

#: Standard deviation of the Gaussian before the derivatives, pixels: larger than the noise of a boundary.
RIDGE_SMOOTHING = 2.0


@one_thread_per_operation()
def suppress_non_maxima(boundary: Tensor) -> Tensor:
    """Keeps the boundary strength where it is a maximum across the boundary, and sets it to 0 elsewhere.

    A pixel is compared with the bilinearly interpolated strength one pixel to either side along the boundary's normal.
    It is kept if neither is greater (J. Canny, PAMI 1986). The normal is the direction of the largest second derivative
    of the smoothed strength, as in P. Dollar and C. L. Zitnick ("Fast Edge Detection Using Structured Forests", PAMI
    2015). Plateaus keep their width.

    Args:
        boundary: [H, W] float32, >= 0.

    Returns:
        [H, W] float32, the input's value or 0.

    Raises:
        ValueError: a shape other than [H, W].

    >>> suppress_non_maxima(torch.tensor([[0.0, 0.2, 0.9, 0.3, 0.0]]).repeat(3, 1))
    tensor([[0.0000, 0.0000, 0.9000, 0.0000, 0.0000],
            [0.0000, 0.0000, 0.9000, 0.0000, 0.0000],
            [0.0000, 0.0000, 0.9000, 0.0000, 0.0000]])
    """
    if boundary.ndim != 2:
        raise ValueError(f"boundary: expected shape [H, W], got {list(boundary.shape)}")
    if boundary.numel() == 0:
        return boundary
    right, down = _normals(boundary)
    # The two sides lie in opposite quadrants. The sign of the product determines which.
    falls = (right * down >= 0).float() * 2 - 1
    right, down = right.abs(), down.abs()
    around = _shifted(boundary)
    stays = torch.ones_like(boundary, dtype=torch.bool)
    for side in (1, -1):
        vertical = torch.where(falls > 0, around[side, 0], around[-side, 0])
        corner = torch.where(falls > 0, around[side, side], around[-side, side])
        near = torch.lerp(boundary, around[0, side], right)  # lerp of two equal values is exact: plateaus are kept
        far = torch.lerp(vertical, corner, right)
        stays &= torch.lerp(near, far, down) <= boundary
    return torch.where(stays, boundary, 0.0)


def _normals(boundary: Tensor) -> tuple[Tensor, Tensor]:
    """Unit vectors (right, down), each [H, W], along which the second derivative is largest in magnitude."""
    size = 2 * round(3 * RIDGE_SMOOTHING) + 1
    smooth = kornia.filters.gaussian_blur2d(
        boundary[None, None], (size, size), (RIDGE_SMOOTHING, RIDGE_SMOOTHING), border_type="replicate"
    )[0, 0]
    around = _shifted(smooth)
    xx = around[0, 1] + around[0, -1] - 2 * smooth
    yy = around[1, 0] + around[-1, 0] - 2 * smooth
    xy = (around[1, 1] + around[-1, -1] - around[1, -1] - around[-1, 1]) / 4
    bends_up = xx + yy > 0  # beside a line, where the normal belongs to the larger eigenvalue
    angle = torch.where(bends_up, torch.atan2(2 * xy, xx - yy), torch.atan2(-2 * xy, yy - xx)) / 2
    return angle.cos(), angle.sin()


def _shifted(values: Tensor) -> dict[tuple[int, int], Tensor]:
    """The values at each of the nine offsets (down, right), as views [H, W]; image borders are replicated."""
    height, width = values.shape
    padded = torch.nn.functional.pad(values[None, None], (1, 1, 1, 1), mode="replicate")[0, 0]
    return {
        (down, right): padded[1 + down : 1 + down + height, 1 + right : 1 + right + width]
        for down in (-1, 0, 1)
        for right in (-1, 0, 1)
    }
