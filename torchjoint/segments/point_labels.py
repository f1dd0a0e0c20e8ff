"""Step 6: labels of the given points and of the points of the graph, which may be fewer."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor

from torchjoint.cloud.prepared import PreparedCloud
from torchjoint.runtime.first_places import numbers_by_first_place
from torchjoint.scene import Hierarchy
from torchjoint.segments.method import Method
from torchjoint.views.state import JointState


class PointLabels(NamedTuple):
    """The segments of the points.

    Images are labelled with numbers that do not depend on the order of the given points: of equally good labels of a
    pixel the lowest counts. Only then labels get the numbers of the result.
    """

    given: Tensor  #: [N] int64, labels of the given points, numbered by first appearance
    of_graph: Tensor  #: [M] int64, the same segments of the graph's points, with numbers of their own
    number: Tensor  #: [S] int64, the number in `given` of each segment in `of_graph`
    hierarchy: Hierarchy | None  #: levels of the given points; None: the method has one level
    graph_hierarchy: Hierarchy | None  #: the same levels of the graph's points, with pieces numbered in their order
    piece_number: Tensor | None  #: [P] int64, the piece in `hierarchy` of each piece in `graph_hierarchy`


def label_points(method: Method, cloud: PreparedCloud, state: JointState) -> PointLabels:
    """Segments the points by the evidence of all frames so far."""
    found, of_point = method.segment(cloud.graph, state), cloud.of_point
    of_graph = found if isinstance(found, Tensor) else found.at()
    number = numbers_by_first_place(of_graph[of_point], int(of_graph.max()) + 1)
    given = number[of_graph][of_point]
    if isinstance(found, Tensor):
        return PointLabels(given, of_graph, number, None, None, None)
    hierarchy, piece_number = found.transferred(of_point)
    return PointLabels(given, of_graph, number, hierarchy, found, piece_number)
