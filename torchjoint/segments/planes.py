"""Step 6: small smooth regions of the cloud, and a plane for each point, fitted within its region."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint import ops
from torchjoint.cloud.edge_weights import EdgeWeights, geometric_weights, segmentator_turn
from torchjoint.cloud.graph import PointGraph
from torchjoint.ops.internal import region_planes
from torchjoint.runtime.threads import all_threads

#: Smallest number of points to which a plane is fitted.
MIN_POINTS = 6


class SmoothRegions(NamedTuple):
    """Small smooth regions: Felzenszwalb-Huttenlocher on the angles between normals."""

    scale: float = 0.003  #: k, weight x points; more gives larger regions; 0: each point is a region of its own
    min_size: int = 15  #: points; smaller regions are joined to a neighbour


#: The small regions of method learned. Regions must not cross creases, so the scale is small. Regions of
#: fewer than 15 points are joined to a neighbour, because their planes are mostly noise.
SMOOTH_REGIONS = SmoothRegions()


class Planes(NamedTuple):
    """One plane per point, fitted to the point and its neighbours in the same region."""

    mean: Tensor  #: [N, 3] metres, mean of these points
    normal: Tensor  #: [N, 3] unit length, on the side of the point's own normal


def small_regions(graph: PointGraph, normals: Tensor, oriented: Tensor, config: SmoothRegions) -> Tensor:
    """Groups points into smooth regions: Felzenszwalb-Huttenlocher with weights 1 - n_i . n_j, squared where convex.

    Args:
        graph: points and edges.
        normals: [N, 3] unit length.
        oriented: [N] bool, whether a normal is oriented.
        config: scale and minimum size.

    Returns:
        [N] int64 regions 0, 1, ...; if `config.scale` is 0, each point is its own region.
    """
    if config.scale == 0:
        return torch.arange(graph.num_points)
    weights = geometric_weights(graph.points, graph.edge_index, normals, oriented, EdgeWeights(segmentator_turn))
    return ops.felzenszwalb(graph.edge_index, weights, graph.num_points, config.scale, config.min_size)


def one_sided_planes(graph: PointGraph, region: Tensor, normals: Tensor) -> Planes:
    """Fits each plane only to neighbours in the same region, so that creases between regions stay sharp.

    Args:
        graph: points and neighbours.
        region: [N] int64.
        normals: [N, 3]; a normal is kept if fewer than MIN_POINTS points (with the point itself) are in its region.

    Returns:
        means [N, 3] metres, and normals [N, 3].
    """
    with all_threads():
        return Planes(*region_planes(graph.points, graph.neighbors, region, normals, MIN_POINTS))
