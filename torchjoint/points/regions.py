"""Step 6, regions: small regions of one smooth surface, and the plane in them on which each point lies."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint import ops
from torchjoint.config import PointGraphConfig, RegionsConfig
from torchjoint.points.edge_weights import geometric_weights, segmentator_turn
from torchjoint.points.graph import PointGraph
from torchjoint.runtime.threads import all_threads

#: Points that a plane is fitted to, at the least.
MIN_POINTS = 6


class Planes(NamedTuple):
    """The plane of each point and those of its neighbours that lie in its own region."""

    mean: Tensor  #: [N, 3] metres
    normal: Tensor  #: [N, 3] unit length, on the side of the point's own normal


def small_regions(graph: PointGraph, normals: Tensor, oriented: Tensor, config: RegionsConfig) -> Tensor:
    """Groups points of one smooth surface: Felzenszwalb-Huttenlocher with 1 - n_i . n_j, squared where it is convex.

    Args:
        normals: [N, 3] unit length.
        oriented: [N] bool, whether a normal's sign is known.

    Returns:
        [N] int64 regions 0, 1, ...; with `config.scale` 0 every point is one.
    """
    if config.scale == 0:
        return torch.arange(graph.num_points)
    turn_only = PointGraphConfig(distance_weight=0, angle_weight=1)
    weights = geometric_weights(graph.points, graph.edge_index, normals, oriented, turn_only, turn=segmentator_turn)
    return ops.felzenszwalb(graph.edge_index, weights, graph.num_points, config.scale, config.min_size)


def one_sided_planes(graph: PointGraph, region: Tensor, normals: Tensor) -> Planes:
    """Planes that no longer look across the border which they are to find: creases become sharp again.

    Args:
        region: [N] int64.
        normals: [N, 3], kept where fewer than MIN_POINTS of the neighbours are in a point's own region.
    """
    with all_threads():
        return Planes(*ops.region_planes(graph.points, graph.neighbors, region, normals, MIN_POINTS))
