"""Step 6: labels of the given points and of the points of the graph, which may be fewer."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor

from torchjoint.cloud.prepared import PreparedCloud
from torchjoint.scene import Hierarchy
from torchjoint.segments.method import Method
from torchjoint.views.state import JointState


class PointLabels(NamedTuple):
    """The segments of the points."""

    given: Tensor  #: [N] int64, labels of the given points
    of_graph: Tensor  #: [M] int64, labels of the graph's points
    hierarchy: Hierarchy | None  #: levels of the given points; None: the method has one level
    piece: Tensor | None  #: [M] int64, the hierarchy's piece of each point of the graph; None: no hierarchy


def label_points(method: Method, cloud: PreparedCloud, state: JointState) -> PointLabels:
    """Segments the points by the evidence of all frames so far."""
    found, of_point = method.segment(cloud.graph, state), cloud.of_point
    if isinstance(found, Tensor):
        return PointLabels(found if of_point is None else found[of_point], found, None, None)
    hierarchy, piece = found, found.piece
    if of_point is not None:
        hierarchy, number = hierarchy.transferred(of_point)
        piece = number[piece]
    return PointLabels(hierarchy.at(), hierarchy.segments_of_pieces(hierarchy.default)[piece], hierarchy, piece)
