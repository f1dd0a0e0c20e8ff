"""Step 4, method zbuffer: a z-buffer of points that are drawn as squares."""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor

from torchjoint.ops._call import call
from torchjoint.ops._checks import check_array, check_number


def splat_depth(row: Tensor, column: Tensor, depth: Tensor, reach: Tensor, height: int, width: int) -> Tensor:
    """Render points as squares into a z-buffer.

    Args:
        row, column: ``[M]`` int64, pixel of each point, inside the image.
        depth: ``[M]`` float32, in any unit, not NaN.
        reach: ``[M]`` int64, half width of each point's square, pixels: 0 is the pixel alone, 1 is 3 x 3 pixels.
        height, width: size of the image, pixels.

    Returns:
        ``[height, width]`` float32, the smallest depth at each pixel, in the unit of ``depth``; ``inf`` if no square
        covers the pixel. No gradient flows through it.

    Raises:
        TypeError: an argument of the wrong type or dtype.
        ValueError: a wrong shape or device, a pixel outside the image, a NaN depth, a negative reach or size.

    Example:
        >>> import torch
        >>> splat_depth(
        ...     torch.tensor([0, 0]), torch.tensor([0, 3]), torch.tensor([2.0, 1.0]), torch.tensor([2, 1]), 2, 4
        ... )
        tensor([[2., 2., 1., 1.],
                [2., 2., 1., 1.]])
    """
    check_array("row", row, torch.int64, (None,), "[M]")
    for name, value, dtype in (
        ("column", column, torch.int64),
        ("depth", depth, torch.float32),
        ("reach", reach, torch.int64),
    ):
        check_array(name, value, dtype, (row.shape[0],), f"[M] = [{row.shape[0]}]")
    check_number("height", height, (int,))
    check_number("width", width, (int,))
    result = call(torch.ops.torchjoint.splat_depth.default, row, column, depth, reach, height, width)
    return cast(Tensor, result)


@torch.library.register_fake("torchjoint::splat_depth")
def _fake(row: Tensor, column: Tensor, depth: Tensor, reach: Tensor, height: int, width: int) -> Tensor:
    return depth.new_empty(height, width)
