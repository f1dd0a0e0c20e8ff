"""Step 7: the points of a frame as markers of their labels in the image, without those that others contradict."""

from __future__ import annotations

import torch
from torch import Tensor

from torchjoint.ops.outvoted_markers import outvoted_markers
from torchjoint.views.nearest_points import nearest_in_cells
from torchjoint.views.visibility import Visible

#: So many nearest markers vote on a marker.
VOTERS = 12

#: Cells of the image, in mean distances of markers, in which other labels are looked for.
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
    """Takes away markers whose neighbours have other labels.

    Visibility has a tolerance, because the points of a slanted surface lie behind one another. So some points are seen
    through what is a few centimetres before them: those of a table through the plate on it. Their pixels have the
    plate's colour, and there the plate has more markers.

    The nearest markers, by place and colour, vote. Distances are those of paths over even colours: the root of the
    squares of pixels and of `color_weight` times the RGB distance. A marker stays if half of its voters, or half of all
    other markers of its label, have its label, so that small things stay. So does one far from all other labels.

    Args:
        markers: [H, W] int32, -1 = none.
        colors: [3, H, W] in [0, 1].
        color_weight: pixels per RGB distance.

    Returns:
        [H, W] int32.
    """
    outvoted = outvoted_markers(markers, colors, color_weight, VOTERS, NEAR)
    return markers.masked_fill(outvoted, -1)
