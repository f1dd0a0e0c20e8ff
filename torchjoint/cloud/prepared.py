"""Step 3: the cloud in the coordinates and in the order in which the steps work. Nothing after it renumbers points."""

from __future__ import annotations

import torch
from torch import Tensor

from torchjoint.cloud.local import LocalFrame, composed, merged_points, order_of_points, points_within, without_copies
from torchjoint.scene import Cloud


def local_cloud(cloud: Cloud, frame: LocalFrame, merge_within: float = 0.0) -> tuple[Cloud, Tensor]:
    """The cloud in float32 coordinates of a local frame, without copies, in an order that only its points decide.

    Args:
        cloud: N points.
        frame: the local frame.
        merge_within: metres; points in one cube with this side are merged; 0: only copies are merged.

    Returns:
        the cloud; and [N] int64, its point for each given point.
    """
    local, of_point = frame.cloud(cloud), None
    if not torch.equal(local.points.to(cloud.points.dtype), cloud.points):
        local, of_point = without_copies(local)  # rounding makes copies
    if merge_within > 0:
        merged = points_within(local.points, merge_within)
        local, of_point = merged_points(local, merged, int(merged.max()) + 1), composed(of_point, merged)
    order = order_of_points(local.points)
    place = torch.empty_like(order)
    place[order] = torch.arange(len(order))
    return local.selected(order), place if of_point is None else place[of_point]
