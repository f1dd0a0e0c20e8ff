"""Step 3: a cloud that is ready for frames: distinct points, centred, and their graph."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor

from torchjoint.cloud.graph import PointGraph
from torchjoint.cloud.local import LocalFrame, composed, merged_points, points_within, without_copies
from torchjoint.scene import Cloud


class PreparedCloud(NamedTuple):
    """A cloud that is ready for frames."""

    graph: PointGraph
    local: LocalFrame  #: of the graph's points
    of_point: Tensor | None  #: [N] int64, the graph's point of each given point; None = itself

    def of_given(self, of_point: Tensor | None) -> PreparedCloud:
        """The same for points [N] of which this has only the distinct ones: `of_point` [N] int64; None = all."""
        return self._replace(of_point=composed(of_point, self.of_point))

    def is_same(self, other: PreparedCloud) -> bool:
        """Whether frames can be seen with one of both clouds, and their evidence be used with the other."""
        return self.graph.is_same(other.graph) and self.local.is_same(other.local)


def local_cloud(cloud: Cloud, frame: LocalFrame, merge_within: float = 0.0) -> tuple[Cloud, Tensor | None]:
    """The cloud in float32 coordinates of a frame, with each point once.

    Args:
        cloud: N points.
        frame: of the coordinates.
        merge_within: metres; the points in a cube with this side count as one; 0: only copies.

    Returns:
        the cloud, and [N] int64 its point of each given one; None = itself.
    """
    local, rounded = without_copies(frame.cloud(cloud))
    if merge_within == 0:
        return local, rounded
    merged = points_within(local.points, merge_within)
    return merged_points(local, merged, int(merged.max()) + 1), composed(rounded, merged)
