"""Steps 7 and 8, method geodesic: propagates the labels of some pixels to all pixels, along cheapest paths."""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor

from torchjoint.ops._call import call
from torchjoint.ops._checks import check_array, check_number


def propagate_labels(
    markers: Tensor,
    colors: Tensor,
    boundary: Tensor,
    color_weight: float,
    boundary_weight: float,
    min_markers: int = 1,
    groups: Tensor | None = None,
) -> Tensor:
    """Geodesic label propagation: give each pixel the label of the marker with the cheapest path to the pixel.

    A path goes from pixel to pixel in the 8-neighbourhood. A step costs its length (1, or the square root of 2)
    + color_weight x RGB distance + boundary_weight x the smaller boundary strength of the two pixels, rounded to an
    eighth; the unit is the width of a pixel. If both weights are 0, labels meet half way, as in a Voronoi diagram. With
    larger weights they meet more often at image edges. Of equally cheap paths, the one from the lower label wins (image
    foresting transform with additive costs: A. Falcão, J. Stolfi, R. Lotufo, PAMI 2004).

    Then each connected part of one label (8-neighbourhood) with fewer than `min_markers` markers loses its label. Its
    pixels are labelled again, with all pixels of the other parts as markers. Nothing changes if no part has enough
    markers.

    Args:
        markers: ``[H, W]`` int32, labels; negative where there is no marker. Markers keep their labels, except in
            parts with too few of them.
        colors: ``[3, H, W]`` float32 RGB in [0, 1].
        boundary: ``[H, W]`` float32 in [0, 1], boundary strength.
        color_weight: cost of an RGB distance of 1, pixels; 0 to 1000.
        boundary_weight: cost of a boundary strength of 1, pixels; 0 to 1000.
        min_markers: smallest number of markers in a connected part of one label; 0 and 1 allow any.
        groups: optional ``[L]`` int32 >= 0, the group of each label 0 ... L - 1; a connected part is then of one group
            instead of one label. If groups ascend, the groups of the result are the labels that the groups of the
            markers would give.

    Returns:
        ``[H, W]`` int32; a copy of ``markers`` if there are no markers at all. No gradient flows through it.

    Raises:
        TypeError: an argument of the wrong type or dtype.
        ValueError: a wrong shape or device, a weight or value out of range, a side of 2^16 pixels or more.

    Example:
        >>> import torch
        >>> markers = torch.tensor([[3, -1, -1, -1, -1, 5]], dtype=torch.int32)
        >>> image = torch.tensor([0.0, 0.9, 0.9, 0.9, 0.9, 0.9]).expand(3, 1, 6)
        >>> propagate_labels(markers, image, torch.zeros(1, 6), 0.0, 0.0)
        tensor([[3, 3, 3, 5, 5, 5]], dtype=torch.int32)
        >>> propagate_labels(markers, image, torch.zeros(1, 6), 10.0, 0.0)
        tensor([[3, 5, 5, 5, 5, 5]], dtype=torch.int32)
    """
    check_array("markers", markers, torch.int32, (None, None), "[H, W]")
    height, width = markers.shape
    check_array("colors", colors, torch.float32, (3, height, width), f"[3, H, W] = [3, {height}, {width}]")
    check_array("boundary", boundary, torch.float32, (height, width), f"[H, W] = [{height}, {width}]")
    check_number("color_weight", color_weight, (int, float))
    check_number("boundary_weight", boundary_weight, (int, float))
    check_number("min_markers", min_markers, (int,))
    if groups is not None:
        check_array("groups", groups, torch.int32, (None,), "[L]")
    arguments = (markers, colors, boundary, float(color_weight), float(boundary_weight), min_markers, groups)
    return cast(Tensor, call(torch.ops.torchjoint.propagate_labels.default, *arguments))


@torch.library.register_fake("torchjoint::propagate_labels")
def _fake(markers: Tensor, *_: object) -> Tensor:
    return markers.new_empty(markers.shape)
