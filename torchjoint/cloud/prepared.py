"""Step 3: the prepared cloud: distinct points, centred, and their graph."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint.cloud.graph import PointGraph
from torchjoint.cloud.local import (
    LocalFrame,
    composed,
    merged_points,
    order_of_points,
    points_within,
    without_copies,
)
from torchjoint.scene import Cloud


class PreparedCloud(NamedTuple):
    """A cloud with its graph. Frames can now be observed."""

    graph: PointGraph
    local: LocalFrame  #: the coordinates of the graph's points
    of_point: Tensor  #: [N] int64, the graph's point of each given point

    def of_given(self, of_point: Tensor | None) -> PreparedCloud:
        """The same graph for N other points; `of_point` [N] int64 gives the given point of each; None = the same."""
        return self if of_point is None else self._replace(of_point=self.of_point[of_point])

    def is_same(self, other: PreparedCloud) -> bool:
        """Whether evidence of frames that was collected with one cloud is valid for the other."""
        return self.graph.is_same(other.graph) and self.local.is_same(other.local)


def local_cloud(cloud: Cloud, frame: LocalFrame, merge_within: float = 0.0) -> tuple[Cloud, Tensor]:
    """The cloud in float32 coordinates of a local frame, without copies, in an order that only its points decide.

    Args:
        cloud: N distinct points.
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
