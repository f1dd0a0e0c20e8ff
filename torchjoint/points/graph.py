"""Step 3: the point graph: nearest neighbours, edges and normals of the cloud."""

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
    """The cloud as a graph, with everything that does not depend on images."""

    points: Tensor  #: [N, 3] metres
    colors: Tensor | None  #: [N, 3] RGB in [0, 1]
    normals: Tensor  #: [N, 3] unit length, not yet turned to the cameras
    has_given_normals: bool  #: given normals are oriented, even where no camera sees the point
    spacing: Tensor  #: [N] metres, mean distance to the nearest neighbours
    edge_index: Tensor  #: [2, E] int64, each edge once
    adjacency: CsrAdjacency  #: CSR adjacency of the edges
    neighbors: Tensor  #: [N, K] int32, nearest first; planes are fitted to them

    @property
    def num_points(self) -> int:
        """N."""
        return self.points.shape[0]

    def is_same(self, other: PointGraph) -> bool:
        """Whether both graphs have the same points and the same normals."""
        return torch.equal(self.points, other.points) and torch.equal(self.normals, other.normals)


def build_point_graph(cloud: Scene, config: PointGraphConfig) -> PointGraph:
    """Builds the point graph of a cloud: neighbours, edges and normals (eq. 3-4); frames are ignored.

    Args:
        cloud: points [N, 3], optional colours and normals.
        config: numbers of neighbours and their reach.
    """
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
    """A graph with points and spacing only, for method scan, which reads neither edges nor normals."""
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
        neighbors: [N, K] int32 or int64, the neighbours of each point.

    Returns:
        [2, E] int64, in the order of their first occurrence in the rows of `neighbors`.

    Raises:
        ValueError: a number outside [0, N).
    """
    with all_threads():
        return ops.neighbor_edges(neighbors)
