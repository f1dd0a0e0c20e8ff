"""A LiDAR scan in segments: the ground, and what stands on it in one piece.

The same graph framework as elsewhere, with weights of its own: an edge weighs its length in units of the gap that is
allowed at its distance from the sensor. What edges of weight up to 1 hold together is a segment.
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

#: Metres over the ground: what a foot belongs to has points lower than this.
FOOT_HEIGHT = 0.4


def segment_scan(points: Tensor, config: ScanConfig | None = None, sensor: Tensor | None = None) -> Tensor:
    """Segments one scan of a LiDAR, without training, colours or normals.

    Points on the :func:`~torchjoint.points.lidar.ground.ground` are one segment, but for the feet of what stands on
    it. The others are joined to their nearest neighbours; edges of :func:`gap_weights` up to 1 make segments, and those of
    fewer than `config.min_size` points are joined to the neighbour that the lightest edge leads to, if it is no heavier than
    `config.joining_gap`.

    Args:
        points: [N, 3] metres, z up.
        config: see :class:`ScanConfig`.
        sensor: [3] metres, where the LiDAR stood; default: the origin.

    Returns:
        [N] int64 labels 0, 1, 2, ... in the order of their first points. The same points have the same labels, whatever
        the number of threads.

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
    """Edges from feet to what they carry: the ground cuts off tyres and shoes at a height where it is never certain.

    A foot is a point between half of `ground_height` and that, and at most `foot_distance` on the level away from what
    stands and is lower than `FOOT_HEIGHT`; the nearest such point is what it belongs to.

    Args:
        points: [N, 3] metres.
        height: [N] float64 metres over the ground.

    Returns:
        [2, F] int64, feet and the points that they belong to.
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
    """Length over the gap that is allowed: w = |p_u - p_v| / (gap + gap_growth min(r_u, r_v)), r the range.

    Args:
        points: [N, 3] metres.
        edges: [2, E].
        sensor: [3] metres; default: the origin.

    Returns:
        [E] float32.
    """
    u, v = edges
    x, y, z = (points[u].double() - points[v].double()).unbind(1)
    length = ((x.square() + y.square()) + z.square()).sqrt()
    reach = directions(points, sensor).range
    return (length / (config.gap + config.gap_growth * torch.minimum(reach[u], reach[v]))).float()


def _components(edges: Tensor, weight: Tensor, on_ground: Tensor, config: ScanConfig) -> Tensor:
    """Components of edges of weight up to 1, and the ground; small ones join the neighbour by the lightest edge.

    That is what Felzenszwalb's and Huttenlocher's two passes do with k = 0, where what is up to 1 weighs nothing.
    """
    near = weight <= config.joining_gap
    of_ground = torch.nonzero(on_ground).flatten()
    chain = torch.stack([of_ground[:-1], of_ground[1:]])
    excess = torch.cat([(weight[near] - 1).clamp(min=0), torch.zeros(chain.shape[1])])
    return ops.felzenszwalb(torch.cat([edges[:, near], chain], 1), excess, len(on_ground), 0.0, config.min_size)
