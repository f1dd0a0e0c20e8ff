"""Step 6: planes of small regions, costs of boundaries, and merging by the mean cost of a boundary."""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint import ops
from torchjoint.cloud.edge_weights import EdgeWeights, geometric_weights, map_edges, segmentator_turn
from torchjoint.cloud.graph import PointGraph
from torchjoint.cloud.normals import angle_between, is_convex, rows_of
from torchjoint.ops.internal import region_planes
from torchjoint.runtime.threads import all_threads

#: Smallest number of points to which a plane is fitted.
MIN_POINTS = 6


class Planes(NamedTuple):
    """One plane per point, fitted to the point and its neighbours in the same region."""

    mean: Tensor  #: [N, 3] metres, mean of these points
    normal: Tensor  #: [N, 3] unit length, on the side of the point's own normal


def small_regions(
    graph: PointGraph, normals: Tensor, oriented: Tensor, scale: float = 0.003, min_size: int = 15
) -> Tensor:
    """Groups points into smooth regions: Felzenszwalb-Huttenlocher with weights 1 - n_i . n_j, squared where convex.

    Args:
        graph: points and edges.
        normals: [N, 3] unit length.
        oriented: [N] bool, whether a normal is oriented.
        scale: k, weight x points. Small, because regions must not cross creases.
        min_size: points; smaller regions are joined to a neighbour, because their planes are mostly noise.

    Returns:
        [N] int64 regions 0, 1, ...
    """
    weights = geometric_weights(graph.points, graph.edge_index, normals, oriented, EdgeWeights(segmentator_turn))
    return ops.felzenszwalb(graph.edge_index, weights, graph.num_points, scale, min_size)


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


def crease_costs(edge_index: Tensor, planes: Planes, oriented: Tensor, convex_factor: float) -> Tensor:
    """How sharply the surface bends along each edge: 0 = flat, 1 = a concave right angle or more.

    With theta the angle between the two planes, the cost is c = min(1, 2 theta / pi) where the surface is concave or
    its normals are not oriented. Where the surface is convex, c is multiplied by `convex_factor`, because objects are
    mostly convex and the boundaries between them concave.

    Args:
        edge_index: [2, E] int64.
        planes: the one-sided plane of each of N points.
        oriented: [N] bool, whether a point's normal is oriented.
        convex_factor: in [0, 1].

    Returns:
        [E] float32 in [0, 1].
    """

    def cost(edges: Tensor) -> Tensor:
        i, j = edges
        both_oriented = oriented[i] & oriented[j]
        first, second = rows_of(planes.normal, i), rows_of(planes.normal, j)
        bent = (angle_between(first, second, both_oriented) * (2 / math.pi)).clamp(max=1)
        convex = both_oriented & is_convex(rows_of(planes.mean, j) - rows_of(planes.mean, i), second - first)
        return torch.where(convex, convex_factor * bent, bent)

    return map_edges(cost, edge_index)


def combined_costs(crease: Tensor, disagreement: Tensor, weight: float, agreement: float) -> Tensor:
    """Costs of edges from geometry and images: c (1 - a (1 - r)) + w (1 - c) r.

    Images count where geometry gives no evidence: on a flat edge the disagreement r counts fully, on a sharp crease
    not at all. Where images see one segment on both sides, the cost of a crease is reduced by the share `a`. If no
    image sees both ends of an edge, r has the neutral value of eq. 6, 1 - r_o. Such an edge costs more than an edge
    within one segment of the images.

    Args:
        crease: [E] c in [0, 1].
        disagreement: [E] r in [0, 1].
        weight: w, >= 0.
        agreement: a in [0, 1].

    Returns:
        [E] float32.
    """
    return crease * (1 - agreement * (1 - disagreement)) + weight * (1 - crease) * disagreement
