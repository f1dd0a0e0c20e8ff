"""Step 1: evaluates a structured forest, which gives the strength of an object boundary at each pixel."""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor

from torchjoint.ops._call import call
from torchjoint.ops._checks import check_array


def structured_forest(
    images: Tensor,
    children: Tensor,
    features: Tensor,
    thresholds: Tensor,
    boundary_counts: Tensor,
    boundary_pixels: Tensor,
    trees_per_site: int,
    stride: int = 2,
) -> Tensor:
    """Compute boundary strength by structured forests: P. Dollár and C. L. Zitnick (PAMI 2015).

    Sites are `stride` pixels apart. At each site, some of the trees vote: the patch around the site, 32 pixels wide,
    reaches a leaf of the tree, and each boundary pixel of the leaf gets a vote. Sums of votes are smoothed.

    On images with even sides, the result equals that of OpenCV's ``detectEdges`` up to rounding: if a feature almost
    equals a threshold, a patch may go to the other child. An odd side is extended by one mirrored pixel (OpenCV
    resamples the image instead). The trees are those of :class:`torchjoint.images.forest.Forest`.

    Args:
        images: ``[B, 3, H, W]`` float32 RGB in [0, 1], at most 2^14 pixels a side.
        children: ``[T, N]`` int32, 0 at a leaf, else 1 + the index of the left child in the tree; the right child is
            the next node. Children come after their parents.
        features: ``[T, N]`` int32, the feature that an inner node tests, in [0, 7228). The first 13 x 16 x 16 are
            values (channel, column, row; the row varies fastest), the others differences of a channel between two cells
            of a 5 x 5 grid.
        thresholds: ``[T, N]`` float32, finite; a patch whose feature is less than the threshold goes left.
        boundary_counts: ``[T, N]`` int32, the number of `boundary_pixels` that belong to a leaf.
        boundary_pixels: ``[P]`` uint8, column * 16 + row of each boundary pixel in a leaf's patch; leaves are in the
            order of trees, then nodes.
        trees_per_site: number of trees that vote at one site, 1 to T; neighbouring sites use different trees.
        stride: 2 or 4 pixels; 4 is faster and less accurate.

    Returns:
        ``[B, H, W]`` float32, >= 0. Runs on torch's threads; the result does not depend on their number, and the result
        of an image does not depend on the other images. No gradient flows through it.

    Raises:
        TypeError: an argument of the wrong type or dtype.
        ValueError: a wrong shape or device, a value out of range or not finite.

    Example:
        A forest of one leaf votes for the same pixel of the patch at each site, so the result is uniform:

        >>> import torch
        >>> leaf, feature = torch.zeros(2, 1, 1, dtype=torch.int32)
        >>> one, middle = torch.ones(1, 1, dtype=torch.int32), torch.tensor([8 * 16 + 8], dtype=torch.uint8)
        >>> structured_forest(torch.rand(1, 3, 32, 32), leaf, feature, torch.zeros(1, 1), one, middle, 1)[0, 14:17, 15]
        tensor([0.0078, 0.0078, 0.0078])
    """
    check_array("images", images, torch.float32, (None, 3, None, None), "[B, 3, H, W]")
    check_array("children", children, torch.int32, (None, None), "[T, N]")
    shape = (children.shape[0], children.shape[1])
    for name, array, dtype in (
        ("features", features, torch.int32),
        ("thresholds", thresholds, torch.float32),
        ("boundary_counts", boundary_counts, torch.int32),
    ):
        check_array(name, array, dtype, shape, f"[T, N] = [{shape[0]}, {shape[1]}]")
    check_array("boundary_pixels", boundary_pixels, torch.uint8, (None,), "[P]")
    for name, number in (("trees_per_site", trees_per_site), ("stride", stride)):
        if isinstance(number, bool) or not isinstance(number, int):
            raise TypeError(f"{name}: expected int, got {type(number).__name__}")
    trees = (children, features, thresholds, boundary_counts, boundary_pixels, trees_per_site)
    return cast(Tensor, call(torch.ops.torchjoint.structured_forest.default, images, *trees, stride))


@torch.library.register_fake("torchjoint::structured_forest")
def _fake(images: Tensor, *_: object) -> Tensor:
    return images.new_empty((images.shape[0], images.shape[2], images.shape[3]))
