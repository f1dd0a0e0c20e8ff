"""Step 6, method learned: colours of the points from the images, for a cloud without colours."""

from __future__ import annotations

import torch
from torch import Tensor

from torchjoint.runtime.threads import parallel_map
from torchjoint.views.observation import Observation
from torchjoint.views.observations import Observations

#: Number of frames that are read at a time.
BLOCK = 8


def image_colors(num_points: int, observations: Observations) -> Tensor | None:
    """The mean colour of the pixels in which each point is visible.

    All sums are of whole numbers, so the order of the frames does not matter.

    Args:
        num_points: N, number of points of the cloud.
        observations: the frames.

    Returns:
        [N, 3] RGB in [0, 1], NaN for a point that no frame sees; None if no frame sees a point.
    """
    total = torch.zeros(num_points, 3, dtype=torch.int64)
    views = torch.zeros(num_points, dtype=torch.int64)
    for start in range(0, len(observations), BLOCK):
        for point, color in parallel_map(_seen_colors, observations[start : start + BLOCK]):
            total.index_add_(0, point, color)
            views += torch.bincount(point, minlength=num_points)
    return (total / (255 * views)[:, None]).float() if views.any() else None


def _seen_colors(seen: Observation) -> tuple[Tensor, Tensor]:
    """The visible points [V] of a frame, and the colours of their pixels, [V, 3] int64 in 0 ... 255."""
    visible = seen.visible
    return visible.point, seen.image[:, visible.row, visible.column].T.long()
