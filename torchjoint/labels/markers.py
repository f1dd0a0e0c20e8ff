"""Step 7: markers (pixels with the label of a point); removes those that the markers around them contradict."""

from __future__ import annotations

import torch
from torch import Tensor

from torchjoint.ops.internal import outvoted_markers
from torchjoint.views.nearest_points import nearest_in_cells
from torchjoint.views.visibility import Visible

#: Number of nearest markers that vote on a marker.
VOTERS = 12

#: A marker is tested only if another label is near: in its cell or in one of the 8 around it. This is the side of a
#: cell, in mean distances between markers.
NEAR = 3.0


def nearest_labels(visible: Visible, point_labels: Tensor, size: tuple[int, int]) -> Tensor:
    """Labels each pixel that contains points with the label of its point nearest to the camera.

    Of equally near points the first counts.

    Args:
        visible: M visible points.
        point_labels: [M] int64, 3D label of each visible point.
        size: (H, W) of the image, pixels.

    Returns:
        [H, W] int32, -1 for pixels without a point.
    """
    pixel = visible.row * size[1] + visible.column
    nearest = nearest_in_cells(pixel, visible.z)
    labels = torch.full((size[0] * size[1],), -1, dtype=torch.int32)
    labels[pixel[nearest]] = point_labels[nearest].to(torch.int32)
    return labels.view(size)


def without_outvoted(markers: Tensor, colors: Tensor, color_weight: float) -> Tensor:
    """Removes markers whose neighbours mostly have other labels.

    Visibility has a depth tolerance, because the points of a slanted surface lie behind one another. So hidden points a
    few centimetres behind a surface count as visible, such as points of a table behind a plate. Their pixels have the
    colour of the plate, and there the plate has more markers.

    The nearest markers, by place and colour, vote (:func:`torchjoint.ops.internal.outvoted_markers`). A marker
    stays if at least half of its voters have its label. It also stays if these are at least half of all other markers
    of its label, so that small objects stay, or if no other label is near.

    Args:
        markers: [H, W] int32, -1 = none.
        colors: [3, H, W] in [0, 1].
        color_weight: pixels per RGB distance.

    Returns:
        [H, W] int32.
    """
    outvoted = outvoted_markers(markers, colors, color_weight, VOTERS, NEAR)
    return markers.masked_fill(outvoted, -1)
