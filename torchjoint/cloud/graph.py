"""Step 3: the point graph: nearest neighbours, edges, normals, and the sides to which normals point."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint import ops
from torchjoint.cloud.local import LocalFrame
from torchjoint.cloud.neighbors import SPACING_NEIGHBORS, nearest_neighbors, neighbor_tables
from torchjoint.cloud.normals import dot, estimate_normals
from torchjoint.cloud.scales import Scales
from torchjoint.runtime.threads import all_threads
from torchjoint.scene import Cloud
from torchjoint.scene.frame import camera_center


class CsrAdjacency(NamedTuple):
    """CSR adjacency of a graph. It gives the edges of some points without a pass over all edges."""

    order: Tensor  #: [E] int32, edge numbers, sorted by the edges' first points
    other_end: Tensor  #: [E] int32, the second point of each edge, in the same order
    start: Tensor  #: [N + 1] int32, the place in `order` where the edges of each point start

    @classmethod
    def of(cls, edge_index: Tensor, num_points: int) -> CsrAdjacency:
        """Sorts the edges of a graph.

        Args:
            edge_index: [2, E] int64, each undirected edge once.
            num_points: N.
        """
        order = torch.argsort(edge_index[0], stable=True)
        start = torch.zeros(num_points + 1, dtype=torch.int32)
        start[1:] = torch.cumsum(torch.bincount(edge_index[0], minlength=num_points), 0)
        return cls(order.to(torch.int32), edge_index[1, order].to(torch.int32), start)


#: Number of neighbours to which planes are fitted, the same as for normals by default. Of these only the neighbours in
#: the point's own region are used, so a plane, unlike a normal, does not round edges.
PLANE_NEIGHBORS = 45

#: With measured scales, the number of neighbours for planes is this factor times the number for normals, because only
#: some of them are in the point's region; at least 40, at most 128.
PLANE_SHARE = 1.5
PLANE_LIMITS = (40, 128)


@dataclass(frozen=True)
class PointGraph:
    """The cloud as a graph, with everything that does not depend on images."""

    points: Tensor  #: [N, 3] metres
    colors: Tensor | None  #: [N, 3] RGB in [0, 1]
    normals: Tensor  #: [N, 3] unit length, not yet oriented to the cameras
    has_given_normals: bool  #: whether the cloud has given normals; these are oriented, also without cameras
    known_spacing: Tensor | None  #: [N] metres; None: it is computed where it is first used
    edge_index: Tensor  #: [2, E] int64, each edge once
    neighbors: Tensor  #: [N, K] int32, nearest first; planes are fitted to them
    scales: Scales | None = None  #: noise and spacing, method learned only
    wide_normals: Tensor | None = None  #: [N, 3] unit length, fitted to `neighbors`, method learned only
    local: LocalFrame = field(default_factory=LocalFrame.of_world)  #: the coordinates of the points
    #: [G] int64, the graph's point of each given point, -1 = none; nothing after step 3 renumbers points
    of_given: Tensor = field(default_factory=lambda: torch.empty(0, dtype=torch.int64))

    @cached_property
    def adjacency(self) -> CsrAdjacency:
        """CSR adjacency of the edges; only images need it."""
        return CsrAdjacency.of(self.edge_index, self.num_points)

    @cached_property
    def spacing(self) -> Tensor:
        """Mean distance of each point to its nearest neighbours, [N] metres."""
        known = self.known_spacing
        return nearest_neighbors(self.points, SPACING_NEIGHBORS).spacing if known is None else known

    @property
    def num_points(self) -> int:
        """N."""
        return self.points.shape[0]

    def of(self, local: LocalFrame, of_given: Tensor) -> PointGraph:
        """The same graph, in a local frame, of G given points; `of_given` [G] int64 has the graph's point of each."""
        return replace(self, local=local, of_given=of_given)

    def is_same(self, other: PointGraph) -> bool:
        """Whether evidence of frames that was collected with one graph is valid for the other."""
        colors, others = (one.points[:0] if one.colors is None else one.colors for one in (self, other))
        same = torch.equal(self.points, other.points) and torch.equal(self.normals, other.normals)
        return same and torch.equal(colors, others) and torch.equal(self.local.origin, other.local.origin)


def build_point_graph(cloud: Cloud, neighbors: int, normal_neighbors: int | Scales) -> PointGraph:
    """Builds the point graph of a cloud: neighbours, edges and normals (eq. 3-4).

    Args:
        cloud: points [N, 3], optional colours and normals.
        neighbors: K, number of neighbours of a point in the graph.
        normal_neighbors: number of neighbours to which normals are fitted; or the scales of the cloud, which determine
            the numbers of neighbours for normals and planes.
    """
    scales = None
    if isinstance(normal_neighbors, int):
        for_normals, for_planes = normal_neighbors, PLANE_NEIGHBORS
    else:
        scales, (few, many) = normal_neighbors, PLANE_LIMITS
        for_normals = scales.normal_neighbors
        for_planes = min(many, max(few, round(PLANE_SHARE * for_normals)))
    points, normals, is_given = cloud.points, cloud.normals, cloud.normals is not None
    table, spacing = neighbor_tables(points, (neighbors, 0 if is_given else for_normals, for_planes), reach=0.0)
    if normals is None:
        normals = estimate_normals(points, table[for_normals])
    edge_index = undirected_edges(table[neighbors])
    around = table[for_planes].contiguous()
    wide = None if scales is None else estimate_normals(points, around)
    return PointGraph(points, cloud.colors, normals, is_given, spacing, edge_index, around, scales, wide)


def build_edgeless_graph(cloud: Cloud) -> PointGraph:
    """A graph with points only, for method scan, which reads neither edges nor normals."""
    points, no_edges = cloud.points, torch.empty(2, 0, dtype=torch.int64)
    no_neighbors = torch.empty(len(points), 0, dtype=torch.int32)
    return PointGraph(points, cloud.colors, torch.zeros_like(points), False, None, no_edges, no_neighbors)


def undirected_edges(neighbors: Tensor, order: Tensor | None = None) -> Tensor:
    """The edges of the symmetrised neighbour graph, each once with i < j (eq. 3).

    Args:
        neighbors: [N, K] int32 or int64, the neighbours of each point.
        order: [N] int32 of :func:`~torchjoint.cloud.neighbors.order_along_space`; only saves time.

    Returns:
        [2, E] int64, in the order of their first occurrence in the rows of `neighbors`.
    """
    with all_threads():
        return ops.neighbor_edges(neighbors, order)


def orientation_votes(graph: PointGraph, point: Tensor, world_to_camera: Tensor) -> Tensor:
    """The direction of normals relative to a camera: [M] int64, 1 = towards it, -1 = away from it, 0 = neither.

    Args:
        graph: points and normals.
        point: [M] int64, the points that the camera sees.
        world_to_camera: [4, 4].
    """
    return dot(graph.normals[point], camera_center(world_to_camera).float() - graph.points[point]).sign().long()


def orient_normals(graph: PointGraph, facing: Tensor) -> tuple[Tensor, Tensor]:
    """Turns normals to the cameras, because a surface is seen from outside.

    Args:
        graph: the graph with the normals.
        facing: [N] int64, sum of :func:`orientation_votes` over the images that see a point.

    Returns:
        normals [N, 3], and whether each normal is oriented, [N] bool.
    """
    if graph.has_given_normals:  # cameras are more reliable than a file, but without cameras trust the file
        facing = torch.where(facing == 0, 1, facing)
    return torch.where(facing[:, None] < 0, -graph.normals, graph.normals), facing != 0
