"""Step 1: contours: smoothed images, thin ridges, and contours that close."""

import torch
from torch import Tensor

from torchjoint import ops
from torchjoint.runtime.threads import one_thread_per_operation, parallel_map


def smooth(images: Tensor, sigma: float) -> Tensor:
    """Gaussian blur of images [B, C, H, W], without gradient, borders replicated; `sigma` in pixels, 0 = none."""
    import cv2  # its blur takes a seventh of the time of kornia's, which is a general convolution

    if sigma == 0 or images.numel() == 0:
        return images
    size = 2 * max(1, round(3 * sigma)) + 1
    smoothed = torch.empty(images.shape, dtype=images.dtype)
    for plane, out in zip(images.detach().flatten(0, 1).numpy(), smoothed.flatten(0, 1).numpy(), strict=True):
        cv2.GaussianBlur(plane, (size, size), sigma, dst=out, borderType=cv2.BORDER_REPLICATE)
    return smoothed


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
        stays &= torch.lerp(near, torch.lerp(vertical, corner, right), down) <= boundary
    return torch.where(stays, boundary, 0.0)


def _normals(boundary: Tensor) -> tuple[Tensor, Tensor]:
    """Unit vectors (right, down), each [H, W], along which the second derivative is largest in magnitude."""
    smoothed = smooth(boundary[None, None], RIDGE_SMOOTHING)[0, 0]
    around = _shifted(smoothed)
    xx = around[0, 1] + around[0, -1] - 2 * smoothed
    yy = around[1, 0] + around[-1, 0] - 2 * smoothed
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
    both sides get the contour's strength, to the power of ``exponent``; all other pixels get 0. This suits eq. 2, w_b
    min(b_i, b_j): an edge across a contour has the contour's weight. An edge from a contour pixel into its own region
    has weight 0 and joins the pixel to that region. So no broad band of strong boundary becomes its own segment.

    Args:
        boundaries: [B, H, W] float32 in [0, 1].
        smoothing: standard deviation of the blur before the watershed, pixels; more gives fewer and larger regions.
        exponent: applied to a contour's strength; more suppresses weak contours.

    Returns:
        [B, H, W] float32 in [0, 1]. The result of an image does not depend on the other images, bit for bit.
    """
    if boundaries.ndim != 3:
        raise ValueError(f"boundaries: expected shape [B, H, W], got {list(boundaries.shape)}")
    if boundaries.numel() == 0:
        return boundaries.new_zeros(boundaries.shape, dtype=torch.float32)
    for index, boundary in enumerate(boundaries):
        if not ((boundary >= 0) & (boundary <= 1)).all():
            raise ValueError(f"boundaries: expected numbers in [0, 1], got others in image {index}")

    def close(boundary: Tensor) -> Tensor:
        return ops.ultrametric_contours(boundary, smooth(boundary[None, None], smoothing)[0, 0]).pow_(exponent)

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
