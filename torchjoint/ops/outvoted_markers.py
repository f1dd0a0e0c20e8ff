"""Steps 7 and 8, method geodesic: finds markers whose neighbours mostly have other labels."""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor

from torchjoint.ops._call import call
from torchjoint.ops._checks import check_array, check_number


def outvoted_markers(markers: Tensor, colors: Tensor, color_weight: float, num_voters: int, near: float) -> Tensor:
    """Find the markers of an image whose neighbours, by position and colour, mostly have other labels.

    The distance of two markers is the Euclidean distance of their vectors (row, column, `color_weight` x red, green,
    blue). The nearest `num_voters` other markers vote. Markers that tie at the last place vote only if all of them fit.
    A marker is outvoted if the voters with its label are fewer than half of its voters, and also fewer than half of all
    other markers with its label, so that small objects keep their markers. Only markers near other labels are tested:
    in square cells of the image, another label must be in the marker's cell or in one of its eight neighbours.

    Args:
        markers: ``[H, W]`` int32, labels; negative where there is no marker.
        colors: ``[3, H, W]`` float32 RGB in [0, 1].
        color_weight: pixels per RGB distance, 0 to 1000.
        num_voters: at least 1.
        near: side of a cell, in mean distances of markers (square root of pixels per marker); rounded up to whole
            pixels.

    Returns:
        ``[H, W]`` bool. No gradient flows through it.

    Raises:
        TypeError: an argument of the wrong type or dtype.
        ValueError: a wrong shape or device, a colour or number out of range.

    Example:
        >>> import torch
        >>> markers = torch.tensor([[0, 0, 0, 1, 0, 0, 1, 1, 1]], dtype=torch.int32)
        >>> outvoted_markers(markers, torch.zeros(3, 1, 9), 100.0, 2, 3.0).int()
        tensor([[0, 0, 0, 1, 0, 0, 0, 0, 0]], dtype=torch.int32)
    """
    check_array("markers", markers, torch.int32, (None, None), "[H, W]")
    height, width = markers.shape
    check_array("colors", colors, torch.float32, (3, height, width), f"[3, H, W] = [3, {height}, {width}]")
    check_number("color_weight", color_weight, (int, float))
    check_number("num_voters", num_voters, (int,))
    check_number("near", near, (int, float))
    arguments = (markers, colors, float(color_weight), num_voters, float(near))
    return cast(Tensor, call(torch.ops.torchjoint.outvoted_markers.default, *arguments))


@torch.library.register_fake("torchjoint::outvoted_markers")
def _fake(markers: Tensor, colors: Tensor, color_weight: float, num_voters: int, near: float) -> Tensor:
    return markers.new_empty(markers.shape, dtype=torch.bool)
