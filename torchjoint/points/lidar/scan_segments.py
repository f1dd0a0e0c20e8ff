"""Step 6, method scan: segments a LiDAR scan into the ground and the connected objects on it.

It uses a neighbour graph like step 3, with other weights: the weight of an edge is its length divided by the gap that
is allowed at its range. The segments are the connected components of the edges with weight <= 1.
"""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from torchjoint import ops
from torchjoint.config import ScanConfig
from torchjoint.points.graph import undirected_edges
from torchjoint.points.lidar.directions import directions
from torchjoint.points.lidar.ground import height_over_ground
from torchjoint.points.neighbors import nearest_neighbors
from torchjoint.runtime.threads import one_thread_per_operation
from torchjoint.scene.checks import as_points

#: Height above the ground, metres: a foot is joined to an object only at points lower than this.
FOOT_HEIGHT = 0.4


def segment_scan(points: Tensor, config: ScanConfig | None = None, sensor: Tensor | None = None) -> Tensor:
    """Segments one scan of a LiDAR, without training, colours or normals.

    Points on the :func:`~torchjoint.points.lidar.ground.ground` are one segment, except for the feet of objects. All
    other points are nodes of a graph of nearest neighbours, with weights from :func:`gap_weights`. Its connected
    components with weights <= 1 are segments. A segment of fewer than `config.min_size` points is joined to the
    neighbour along its lightest edge, if the weight of this edge is at most `config.joining_gap`.

    Args:
        points: [N, 3] metres, z up.
        config: see :class:`ScanConfig`.
        sensor: [3] metres, position of the LiDAR; default: the origin.

    Returns:
        [N] int64 labels 0, 1, 2, ... in the order of their first points. The labels do not depend on the number of
        threads.

    Raises:
        ValueError, TypeError: naming the argument, what was expected and what came.
    """
    points, config = as_points(points), config or ScanConfig()
    height = height_over_ground(points, config, sensor)
    with torch.no_grad(), one_thread_per_operation():
        on_ground = height < config.ground_height
        standing = torch.nonzero(~on_ground).flatten()
        edges = standing[undirected_edges(nearest_neighbors(points[standing], config.neighbors).indices)]
        weight = gap_weights(points, edges, config, sensor)
        feet = foot_edges(points, height, config)
        on_ground[feet[0]] = False
        edges, weight = torch.cat([edges, feet], 1), torch.cat([weight, torch.zeros(feet.shape[1])])
        return _components(edges, weight, on_ground, config)


def foot_edges(points: Tensor, height: Tensor, config: ScanConfig) -> Tensor:
    """Edges from feet to their objects: `ground_height` alone would cut off tyres and shoes, where ground is uncertain.

    A foot is a point whose height is between `ground_height` / 2 and `ground_height`, at a horizontal distance of at
    most `foot_distance` from a point between `ground_height` and `FOOT_HEIGHT`. It is joined to the nearest such point.

    Args:
        points: [N, 3] metres, z up.
        height: [N] float64 metres above the ground.
        config: `ground_height` and `foot_distance`.

    Returns:
        [2, F] int64: feet, and the points to which they are joined.
    """
    low = torch.nonzero((height >= config.ground_height) & (height < FOOT_HEIGHT)).flatten()
    feet = torch.nonzero((height > config.ground_height / 2) & (height < config.ground_height)).flatten()
    if config.foot_distance == 0 or len(low) == 0 or len(feet) == 0:
        return torch.empty(2, 0, dtype=torch.int64)
    places = points[:, :2].double().numpy()
    tree = cKDTree(places[low.numpy()])
    distance, nearest = tree.query(places[feet.numpy()], distance_upper_bound=config.foot_distance)
    near = torch.from_numpy(np.isfinite(distance))
    return torch.stack([feet[near], low[torch.from_numpy(nearest)[near]]])


def gap_weights(points: Tensor, edges: Tensor, config: ScanConfig, sensor: Tensor | None = None) -> Tensor:
    """Length of each edge divided by the allowed gap: w = |p_u - p_v| / (gap + gap_growth min(r_u, r_v)), r = range.

    Args:
        points: [N, 3] metres.
        edges: [2, E] int64.
        config: gap and gap_growth.
        sensor: [3] metres, position of the LiDAR; default: the origin.

    Returns:
        [E] float32.
    """
    u, v = edges
    x, y, z = (points[u].double() - points[v].double()).unbind(1)
    length = ((x.square() + y.square()) + z.square()).sqrt()
    reach = directions(points, sensor).range
    return (length / (config.gap + config.gap_growth * torch.minimum(reach[u], reach[v]))).float()


def _components(edges: Tensor, weight: Tensor, on_ground: Tensor, config: ScanConfig) -> Tensor:
    """Connected components of edges with weight <= 1, and the ground; small ones are joined along their lightest edge.

    The two passes of Felzenszwalb-Huttenlocher do this with k = 0, if the weights are max(0, w - 1).
    """
    near = weight <= config.joining_gap
    of_ground = torch.nonzero(on_ground).flatten()
    chain = torch.stack([of_ground[:-1], of_ground[1:]])
    excess = torch.cat([(weight[near] - 1).clamp(min=0), torch.zeros(chain.shape[1])])
    return ops.felzenszwalb(torch.cat([edges[:, near], chain], 1), excess, len(on_ground), 0.0, config.min_size)
