"""Steps 1 and 2: the 8-connected pixel graph of an image, and its segmentation (eq. 1-2)."""

from functools import lru_cache

import torch
from torch import Tensor

from torchjoint import ops
from torchjoint.config import ImageGraphConfig, ImageSegmentsConfig
from torchjoint.images.contours import smooth

#: Edges of images of at most so many pixels are kept for the next image.
KEPT_PIXELS = 2_000_000


@lru_cache(maxsize=2)
def grid_edges(height: int, width: int) -> Tensor:
    """Edges of the 8-connected grid, each once; pixels are numbered row by row (eq. 1).

    Returns:
        [2, E] int64: first all edges to the right, then down, down-right and up-right.
    """
    pixels = torch.arange(height * width).view(height, width)
    pairs = [(a.reshape(-1), b.reshape(-1)) for a, b in _neighbor_views(pixels)]
    return torch.stack([torch.cat([a for a, _ in pairs]), torch.cat([b for _, b in pairs])])


def pixel_weights(image: Tensor, boundary: Tensor, config: ImageGraphConfig) -> Tensor:
    """Weight of each edge of :func:`grid_edges`: w = w_c |c_i - c_j| + w_b min(b_i, b_j) (eq. 2).

    Args:
        image: [3, H, W] RGB in [0, 1].
        boundary: [H, W] in [0, 1].
        config: w_c, w_b and the smoothing of the colours.

    Returns:
        [E] float32.
    """
    colors = smooth(image[None], config.smoothing)[0]
    weights = []
    for (color_i, color_j), (b_i, b_j) in zip(_neighbor_views(colors), _neighbor_views(boundary), strict=True):
        red, green, blue = (color_i - color_j).square_()
        # The root is taken in float64: torch's float32 root may be wrong in the last bit.
        distance = red.add_(green).add_(blue).double().sqrt_().float()
        weights.append(distance.mul_(config.color_weight).add_(torch.minimum(b_i, b_j).mul_(config.boundary_weight)))
    return torch.cat([weight.reshape(-1) for weight in weights])


def segment_image(image: Tensor, boundary: Tensor, graph: ImageGraphConfig, segments: ImageSegmentsConfig) -> Tensor:
    """Felzenszwalb-Huttenlocher segmentation of an image's pixel graph (step 2).

    Args:
        image: [3, H, W] RGB in [0, 1].
        boundary: [H, W] in [0, 1].
        graph: weights of eq. 2 and the smoothing of the colours.
        segments: scale and minimum size.

    Returns:
        [H, W] int64 labels 0, 1, 2, ... in the order of their first pixel, row by row.
    """
    # The edges of large images take 64 bytes a pixel: too much to keep.
    edge_index = (grid_edges if boundary.numel() <= KEPT_PIXELS else grid_edges.__wrapped__)(*boundary.shape)
    weight = pixel_weights(image, boundary, graph)
    return ops.felzenszwalb(edge_index, weight, boundary.numel(), segments.scale, segments.min_size).view_as(boundary)


def _neighbor_views(values: Tensor) -> list[tuple[Tensor, Tensor]]:
    """Both ends of all grid edges in the last two dimensions, as views: right, down, down-right and up-right."""
    return [
        (values[..., :, :-1], values[..., :, 1:]),
        (values[..., :-1, :], values[..., 1:, :]),
        (values[..., :-1, :-1], values[..., 1:, 1:]),
        (values[..., 1:, :-1], values[..., :-1, 1:]),
    ]
