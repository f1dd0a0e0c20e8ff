"""Step 6, method learned: colours of the points from the images, for a cloud without colours."""

from __future__ import annotations

import torch
from scipy.spatial import cKDTree
from torch import Tensor

from torchjoint.runtime.threads import parallel_map
from torchjoint.views.observation import Observation
from torchjoint.views.observations import Observations

#: Number of frames that are read at a time.
BLOCK = 8

#: Among so many nearest points, the first of the equally near ones counts: in a cubic grid, a point has six.
NEAREST = 8

#: Number of points that are searched at a time.
ROWS = 100_000


def image_colors(points: Tensor, observations: Observations) -> Tensor | None:
    """The mean colour of the pixels that see a point.

    A point that no frame sees has the colour of the nearest one that is seen, of equally near ones the first. All sums
    are of whole numbers, so the order of the frames does not matter.

    Args:
        points: [N, 3] metres.
        observations: the frames.

    Returns:
        [N, 3] RGB in [0, 1]; None if no frame sees a point.
    """
    total = torch.zeros(len(points), 3, dtype=torch.int64)
    views = torch.zeros(len(points), dtype=torch.int64)
    for start in range(0, len(observations), BLOCK):
        for point, color in parallel_map(_seen_colors, observations[start : start + BLOCK]):
            total.index_add_(0, point, color)
            views += torch.bincount(point, minlength=len(points))
    is_seen = views > 0
    if not is_seen.any():
        return None
    colors = (total / (255 * views.clamp(min=1))[:, None]).float()
    if not is_seen.all():
        colors[~is_seen] = colors[is_seen][_nearest(points[~is_seen], points[is_seen])]
    return colors


def _seen_colors(seen: Observation) -> tuple[Tensor, Tensor]:
    """The visible points [V] of a frame, and the colours of their pixels, [V, 3] int64 in 0 ... 255."""
    visible = seen.visible
    return visible.point, seen.image[:, visible.row, visible.column].T.long()


def _nearest(points: Tensor, others: Tensor) -> Tensor:
    """The nearest of `others` [M, 3] to each of the points [N, 3]; of equally near ones the first; [N] int64."""
    tree = cKDTree(others.double().numpy())
    count = list(range(1, min(NEAREST, len(others)) + 1))

    def nearest(part: Tensor) -> Tensor:
        distance, index = map(torch.from_numpy, tree.query(part.double().numpy(), count))
        return torch.where(distance == distance[:, :1], index, len(others)).min(1).values

    return torch.cat(parallel_map(nearest, points.split(ROWS)))
