"""Step 7: the points of a frame as markers of their labels in the image, without those that others contradict."""

from __future__ import annotations

import math

import torch
from scipy.spatial import cKDTree
from torch import Tensor

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
    row, column = torch.nonzero(markers >= 0, as_tuple=True)
    label = markers[row, column].long()
    asked = _near_others(row, column, label, markers.numel())
    if not len(asked):
        return markers
    place = torch.cat([torch.stack([row, column]), color_weight * colors[:, row, column]]).T.double().numpy()
    count = min(VOTERS + 2, len(label))  # the first is the marker itself; of equally far last ones all vote, or none
    distance, found = (torch.from_numpy(one)[:, 1:] for one in cKDTree(place).query(place[asked], k=count))
    votes = distance < (distance[:, -1:] if count == VOTERS + 2 else math.inf)
    agree = (votes & (label[found] == label[asked, None])).sum(1)
    others = torch.bincount(label)[label[asked]] - 1
    outvoted = asked[2 * agree < torch.minimum(votes.sum(1), others)]
    kept = markers.clone()
    kept[row[outvoted], column[outvoted]] = -1
    return kept


def _near_others(row: Tensor, column: Tensor, label: Tensor, area: int) -> Tensor:
    """[K] int64: the markers that have another label in their cell of the image, or in one of the eight around it.

    Args:
        row, column: [M] int64, pixels of the markers.
        label: [M] int64.
        area: of the image, pixels.
    """
    if not len(label):
        return label
    cell = math.ceil(NEAR * math.sqrt(area / len(label)))
    y, x = row // cell, column // cell
    num_rows, num_columns = int(y.max()) + 1, int(x.max()) + 1

    def highest(values: Tensor) -> Tensor:
        most = torch.full((num_rows * num_columns,), -math.inf, dtype=torch.float64)
        most.scatter_reduce_(0, y * num_columns + x, values, "amax")
        return torch.nn.functional.max_pool2d(most.view(1, num_rows, num_columns), 3, stride=1, padding=1)[0]

    return (highest(label.double()) != -highest(-label.double()))[y, x].nonzero().flatten()
