"""Operators on images: contours and labels of pixels (steps 1, 7, 8)."""

import torch
from torch import Tensor

from torchjoint.ops._call import call, register_fakes
from torchjoint.ops._checks import check_array, check_number


def ultrametric_contours(boundary: Tensor, relief: Tensor) -> Tensor:
    """Close the contours of a boundary map: compute its ultrametric contour map.

    First a watershed divides the image into the basins of ``relief``: steepest descent over the eight neighbours leads
    from each pixel to a lowest pixel (of equally low pixels, to the one that comes first row by row). The region
    boundary of two basins consists of the pairs of neighbouring pixels with one pixel in each basin. The strength of a
    pair is the larger value of ``boundary`` at its two pixels; the strength of a region boundary is the mean over its
    pairs. The two regions with the weakest region boundary are merged, and their boundaries with the same third region
    are joined, until one region is left. The height of a region boundary is the strength at which its two sides become
    one region. Thresholding at a height gives regions with closed contours; a lower threshold subdivides these regions
    (P. Arbeláez et al., "Contour Detection and Hierarchical Image Segmentation", PAMI 2011, with another watershed and
    without orientations).

    Strengths are rounded to 16 bits, so that sums are exact. Of equally weak region boundaries, the one with the
    lowest number is merged. They are numbered by their first pair: pairs to the right come first, then down, down-right
    and up-right. Joined region boundaries keep the lower number.

    Args:
        boundary: ``[H, W]`` float32, strength in [0, 1].
        relief: ``[H, W]`` float32, not NaN; usually the smoothed boundary map, which has fewer basins.

    Returns:
        ``[H, W]`` float32 in [0, 1]: the largest height of the region boundaries at a pixel, 0 if all its neighbours
        are in the same region. Lines are two pixels wide, one pixel on each side; diagonal lines are up to four pixels
        wide. No gradient flows through it.

    Raises:
        TypeError: an argument of the wrong type or dtype.
        ValueError: a wrong shape or device, a strength out of range, a NaN.

    Example:
        >>> import torch
        >>> boundary = torch.tensor([[0.0, 0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.5, 0.0, 0.0]])
        >>> ultrametric_contours(boundary, boundary)
        tensor([[0.0000, 0.0000, 0.7500, 0.7500, 0.0000],
                [0.0000, 0.0000, 0.7500, 0.7500, 0.0000]])
    """
    check_array("boundary", boundary, torch.float32, (None, None), "[H, W]")
    check_array("relief", relief, torch.float32, tuple(boundary.shape), "[H, W]")
    return call("ultrametric_contours", boundary, relief)


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
    check_array("colors", colors, torch.float32, (3, height, width), "[3, H, W]")
    check_array("boundary", boundary, torch.float32, (height, width), "[H, W]")
    check_number("color_weight", color_weight, (int, float))
    check_number("boundary_weight", boundary_weight, (int, float))
    check_number("min_markers", min_markers, (int,))
    if groups is not None:
        check_array("groups", groups, torch.int32, (None,), "[L]")
    arguments = (markers, colors, boundary, float(color_weight), float(boundary_weight), min_markers, groups)
    return call("propagate_labels", *arguments)


register_fakes(
    ultrametric_contours=lambda boundary, _relief: boundary.new_empty(boundary.shape),
    propagate_labels=lambda markers, *_: markers.new_empty(markers.shape),
)
