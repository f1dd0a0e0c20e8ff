"""Step 3: the graph of the cloud's nearest neighbours, normals, and the geometric weight of its edges."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint import ops
from torchjoint.config import PointGraphConfig
from torchjoint.points.neighbors import SPACING_NEIGHBORS, nearest_neighbors, neighbor_tables
from torchjoint.points.normals import estimate_normals
from torchjoint.runtime.threads import all_threads
from torchjoint.scene import Scene
from torchjoint.views.csr_adjacency import CsrAdjacency


class PointGraph(NamedTuple):
    """The cloud as a graph, with all that depends on no image."""

    points: Tensor  #: [N, 3]
    colors: Tensor | None  #: [N, 3]
    normals: Tensor  #: [N, 3] unit length, of any sign
    normals_are_given: bool  #: and so their signs mean something where no camera sees the point
    spacing: Tensor  #: [N] metres
    edge_index: Tensor  #: [2, E]
    adjacency: CsrAdjacency  #: the edges by their first point
    neighbors: Tensor  #: [N, K] int32, nearest first, that planes are fitted to

    @property
    def num_points(self) -> int:
        """N."""
        return self.points.shape[0]

    def is_same(self, other: PointGraph) -> bool:
        """Whether both are of the same points with the same normals."""
        return torch.equal(self.points, other.points) and torch.equal(self.normals, other.normals)


def build_point_graph(cloud: Scene, config: PointGraphConfig) -> PointGraph:
    """Neighbours, edges and normals of a cloud (its frames are not looked at)."""
    for_normals = config.normal_neighbors if cloud.normals is None else 0
    counts = (config.neighbors, for_normals, config.plane_neighbors)
    table, spacing = neighbor_tables(cloud.points, counts, config.reach)
    normals = cloud.normals
    if normals is None:
        normals = estimate_normals(cloud.points, table[for_normals])
    edge_index = undirected_edges(table[config.neighbors])
    return PointGraph(
        cloud.points,
        cloud.colors,
        normals,
        cloud.normals is not None,
        spacing,
        edge_index,
        CsrAdjacency.of(edge_index, len(cloud.points)),
        table[config.plane_neighbors].contiguous(),
    )


def build_edgeless_graph(cloud: Scene) -> PointGraph:
    """The points and their spacing alone, for a segmentation that reads neither edges nor normals."""
    spacing = nearest_neighbors(cloud.points, SPACING_NEIGHBORS).spacing
    no_edges = torch.empty(2, 0, dtype=torch.int64)
    return PointGraph(
        cloud.points,
        cloud.colors,
        torch.zeros_like(cloud.points),
        False,
        spacing,
        no_edges,
        CsrAdjacency.of(no_edges, len(cloud.points)),
        torch.empty(len(cloud.points), 0, dtype=torch.int32),
    )


def undirected_edges(neighbors: Tensor) -> Tensor:
    """The edges of the symmetrised neighbour graph, each once with i < j (eq. 3).

    Args:
        neighbors: [N, K] int32 or int64.

    Returns:
        [2, E] int64, in the order in which rows of `neighbors` name them.
    """
    with all_threads():
        return ops.neighbor_edges(neighbors)
