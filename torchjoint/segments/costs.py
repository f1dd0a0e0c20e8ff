"""Step 6: the cost of each edge of the point graph, from creases and from the images' evidence."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torchjoint.cloud._vectors import rows_of
from torchjoint.cloud.edge_weights import map_edges
from torchjoint.cloud.normals import angle_between, is_convex
from torchjoint.segments.planes import Planes


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
