"""Step 6 for a given cloud, whose graph may have fewer points: labels of both, and all levels if there are any."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor

from torchjoint.scene import Hierarchy
from torchjoint.segments.prepared_cloud import PreparedCloud
from torchjoint.segments.segments import point_hierarchy, segment_points
from torchjoint.views.state import JointState


class PointLabels(NamedTuple):
    """The segments of the points."""

    given: Tensor  #: [N] int64, labels of the given points
    of_graph: Tensor  #: [M] int64, labels of the graph's points
    hierarchy: Hierarchy | None  #: of the given points; only method learned makes one
    piece: Tensor | None  #: [M] int64, its piece of each of the graph's points


def label_points(cloud: PreparedCloud, state: JointState) -> PointLabels:
    """Segments the points with the evidence so far, by the cloud's method."""
    graph, of_point = cloud.graph, cloud.of_point
    if cloud.method != "learned":
        labels = segment_points(graph, state, cloud.definite)
        return PointLabels(labels if of_point is None else labels[of_point], labels, None, None)
    hierarchy = point_hierarchy(graph, state, cloud.definite)
    piece = hierarchy.piece
    if of_point is not None:
        hierarchy, number = hierarchy.transferred(of_point)
        piece = number[piece]
    return PointLabels(hierarchy.at(), hierarchy.segments_of_pieces(hierarchy.default)[piece], hierarchy, piece)
