"""Step 6, method scan: segments a LiDAR scan into the ground and the connected objects on it.

It uses a neighbour graph like step 3, with other weights: the weight of an edge is its length divided by the gap that
is allowed at its range. The segments are the connected components of the edges with weight <= 1.
"""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor

from torchjoint import ops
from torchjoint.cloud._vectors import rows_of
from torchjoint.cloud.edge_weights import map_edges
from torchjoint.cloud.graph import undirected_edges
from torchjoint.cloud.neighbors import SPACING_NEIGHBORS, nearest_neighbors
from torchjoint.config import ScanConfig
from torchjoint.runtime.threads import one_thread_per_operation
from torchjoint.scene.checks import as_points
from torchjoint.segments.scan.directions import directions, ranges
from torchjoint.segments.scan.ground import GROUND_HEIGHT, height_over_ground
from torchjoint.segments.scan.ground_growth import grow_ground
from torchjoint.segments.scan.recognition import Rings, find_rings

#: Neighbours of a point in the graph. With fewer, thin parts between denser ones are lost; more take longer.
NEIGHBORS = 12

#: Largest distance over which a small segment is joined to a neighbour, in allowed gaps. Farther away it is mostly
#: another object: a small segment that stands far from all others keeps its own label.
JOINING_GAP = 2.0

#: Largest mean distance of a point of the ground to its nearest neighbours, in allowed gaps.
GROUND_GAP = 0.6

#: The part of the allowed gap that grows with range must span at least this many steps between rings.
RINGS_IN_GAP = 4


def segment_scan(
    points: Tensor,
    config: ScanConfig | None = None,
    rings: Rings | Literal["search"] | None = "search",
    spacing: Tensor | None = None,
) -> Tensor:
    """Segments one scan of a LiDAR, without training, colours or normals.

    Points on the ground (:func:`~torchjoint.segments.scan.ground_growth.grow_ground`) are one segment. All other points
    are nodes of a graph of nearest neighbours, with weights from :func:`gap_weights`. Its connected components with
    weights <= 1 are segments. A segment of fewer than `config.min_size` points is joined to the neighbour along its
    lightest edge, if the weight of this edge is at most JOINING_GAP. Neighbours and weights are computed after the
    rings were moved closer together (:func:`with_near_rings`).

    Args:
        points: [N, 3] metres, z up, the sensor at the origin.
        config: see :class:`ScanConfig`.
        rings: of the scan; None: it has none; "search": they are searched for.
        spacing: [N] metres, mean distance to the nearest neighbours; None: it is computed.

    Returns:
        [N] int64 labels 0, 1, 2, ... in the order of their first points. The labels do not depend on the number of
        threads.

    Raises:
        ValueError, TypeError: naming the argument, what was expected and what came.
    """
    config = config or ScanConfig()
    with torch.no_grad(), one_thread_per_operation():
        points = as_points(points)
        rings = find_rings(points) if rings == "search" else rings
        if spacing is None:
            spacing = nearest_neighbors(points, SPACING_NEIGHBORS).spacing
        return components(*scan_graph(points, config, rings, spacing), config)


def scan_graph(
    points: Tensor, config: ScanConfig, rings: Rings | None, spacing: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """The graph of the points that do not belong to the ground.

    Args:
        points: [N, 3] metres, z up, the sensor at the origin.
        config: see :class:`ScanConfig`.
        rings: of the scan; None: it has none.
        spacing: [N] metres, mean distance to the nearest neighbours.

    Returns:
        [2, E] int64 edges; [E] float32 weights; [N] bool, True for ground.
    """
    seen = directions(points)
    # Points that stand alone may be outliers. The ground is denser than what rises from it far away.
    alone = spacing / (config.gap + config.gap_growth * seen.range)
    height = height_over_ground(points, _or_all(alone <= GROUND_GAP))
    drawn = with_near_rings(points, rings, config)
    standing = torch.nonzero(height >= GROUND_HEIGHT).flatten()
    edges = standing[undirected_edges(nearest_neighbors(drawn[standing], NEIGHBORS).indices)]
    weight = gap_weights(drawn, edges, config)
    on_ground = grow_ground(points, height, seen, edges[:, weight <= 1], config, _or_all(alone <= 1))
    above = ~on_ground[edges].any(0)
    return edges[:, above], weight[above], on_ground


def _or_all(used: Tensor) -> Tensor | None:
    return used if bool(used.any()) else None


def with_near_rings(points: Tensor, rings: Rings | None, config: ScanConfig) -> Tensor:
    """Scales the elevations of points down, so that the step between two rings is a quarter of the gap's growth.

    With few beams, two rings are farther apart than two objects side by side. After the scaling, one gap is large
    enough to join rings and small enough to separate such objects. If the rings are already near enough, or unknown,
    the points are returned unchanged.

    Args:
        points: [N, 3] metres, z up, the sensor at the origin.
        rings: the rings of the scan; None: unknown.
        config: gap_growth.
    """
    if rings is None or config.gap_growth >= RINGS_IN_GAP * rings.step:
        return points
    seen = directions(points)
    elevation = seen.elevation * (config.gap_growth / (RINGS_IN_GAP * rings.step))
    flat = seen.range * elevation.cos()
    x, y, z = flat * seen.azimuth.cos(), flat * seen.azimuth.sin(), seen.range * elevation.sin()
    return torch.stack([x, y, z], dim=1).float()


def gap_weights(points: Tensor, edges: Tensor, config: ScanConfig) -> Tensor:
    """Length of each edge divided by the allowed gap: w = |p_u - p_v| / (gap + gap_growth min(r_u, r_v)), r = range.

    Args:
        points: [N, 3] metres, the sensor at the origin.
        edges: [2, E] int64.
        config: gap and gap_growth.

    Returns:
        [E] float32.
    """
    reach = ranges(points)

    def weight(some: Tensor) -> Tensor:
        u, v = some
        x, y, z = (rows_of(points, u).double() - rows_of(points, v).double()).unbind(1)
        length = ((x.square() + y.square()) + z.square()).sqrt()
        return (length / (config.gap + config.gap_growth * torch.minimum(reach[u], reach[v]))).float()

    return map_edges(weight, edges)


def components(edges: Tensor, weight: Tensor, on_ground: Tensor, config: ScanConfig) -> Tensor:
    """Labels [N] int64: connected components of edges with weight <= 1, and the ground; small components are joined.

    Felzenszwalb-Huttenlocher does both with k = 0 and weights max(0, w - 1). Its second pass joins each component of
    fewer than `config.min_size` points along its lightest edge.
    """
    near = weight <= JOINING_GAP
    of_ground = torch.nonzero(on_ground).flatten()
    chain = torch.stack([of_ground[:-1], of_ground[1:]])
    excess = torch.cat([(weight[near] - 1).clamp(min=0), torch.zeros(chain.shape[1], dtype=torch.float32)])
    return ops.felzenszwalb(torch.cat([edges[:, near], chain], 1), excess, len(on_ground), 0.0, config.min_size)
