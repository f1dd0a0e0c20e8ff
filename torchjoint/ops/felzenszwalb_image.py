"""Steps 1 and 2: graph-based segmentation of images, without a stored list of edges."""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor

from torchjoint.ops._call import call
from torchjoint.ops._checks import check_number, check_tensor


def felzenszwalb_image(
    images: Tensor,
    boundaries: Tensor | None = None,
    *,
    scale: float,
    min_size: int = 0,
    color_weight: float = 1.0,
    boundary_weight: float = 1.0,
) -> Tensor:
    """Segment images by :func:`felzenszwalb` on their 8-connected pixel grids; edges are computed, not stored.

    The edges are those of :func:`torchjoint.images.pixel_graph.grid_edges`, the weights those of
    :func:`torchjoint.images.pixel_graph.pixel_weights`,
    ``w = color_weight |c_i - c_j| + boundary_weight min(b_i, b_j)`` (M. Abello et al., ICRA 2021, eq. 1-2). So the
    labels are bit for bit the same as with an explicit list of edges. The images of a batch are distributed over
    torch's threads; the labels do not depend on the number of threads. In addition to the result, less than 40
    bytes per pixel are used.

    Args:
        images: ``[B, C, H, W]`` float32, any number of channels; the default weights suit RGB in [0, 1].
        boundaries: ``[B, H, W]`` float32, boundary strength of each pixel; None: no boundaries.
        scale: k, in units of weight times pixels: larger values give larger segments.
        min_size: segments of fewer pixels than this are joined to a neighbour.
        color_weight: w_c >= 0.
        boundary_weight: w_b >= 0.

    Returns:
        ``[B, H, W]`` int64 labels, in each image 0, 1, 2, ... in the order of their first pixel, row by row.

    Raises:
        TypeError: an argument of the wrong type or dtype.
        ValueError: a wrong shape or device, a value that is not finite (or above 1e18), a negative number.

    Example:
        >>> import torch
        >>> image = torch.zeros(1, 3, 2, 4)
        >>> image[..., 2:] = 1.0
        >>> felzenszwalb_image(image, scale=1.0)
        tensor([[[0, 0, 1, 1],
                 [0, 0, 1, 1]]])
    """
    check_tensor("images", images, (torch.float32,))
    if images.dim() != 4:
        raise ValueError(f"images: expected shape [B, C, H, W], got {list(images.shape)}")
    if boundaries is not None:
        check_tensor("boundaries", boundaries, (torch.float32,))
        expected = [images.shape[0], images.shape[2], images.shape[3]]
        if list(boundaries.shape) != expected:
            raise ValueError(f"boundaries: expected shape [B, H, W] = {expected}, got {list(boundaries.shape)}")
    check_number("scale", scale, (int, float))
    check_number("min_size", min_size, (int,))
    check_number("color_weight", color_weight, (int, float))
    check_number("boundary_weight", boundary_weight, (int, float))
    labels = call(
        torch.ops.torchjoint.felzenszwalb_image.default,
        images,
        boundaries,
        float(scale),
        min_size,
        float(color_weight),
        float(boundary_weight),
    )
    return cast(Tensor, labels)


@torch.library.register_fake("torchjoint::felzenszwalb_image")
def _fake(images: Tensor, *_: object) -> Tensor:
    batch, _channels, height, width = images.shape
    return images.new_empty((batch, height, width), dtype=torch.int64)
