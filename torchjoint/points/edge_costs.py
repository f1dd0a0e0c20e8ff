"""Step 6, regions: the cost of each edge of the point graph, from creases and from what images see."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torchjoint.points._vectors import rows_of
from torchjoint.points.edge_weights import map_edges
from torchjoint.points.normals import angle_between, is_convex
from torchjoint.points.regions import Planes


def crease_costs(edge_index: Tensor, planes: Planes, oriented: Tensor, convex_factor: float) -> Tensor:
    """How sharply the surface is bent along edges: 0 flat, 1 a concave right angle or more.

    With theta the angle of the two planes, min(1, 2 theta / pi) where the surface is concave, or where it is not known
    which side of it is outside; `convex_factor` times as much where it is convex: objects mostly are, and the borders
    between them concave.

    Args:
        edge_index: [2, E].
        oriented: [N] bool, whether the sign of a point's normal is known.

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


def with_images(crease: Tensor, disagreement: Tensor, weight: float, agreement: float) -> Tensor:
    """Costs of edges, from shape and images: c (1 - a (1 - r)) + w (1 - c) r.

    Images count where geometry is silent: their disagreement r adds to a flat edge in full and to a sharp crease not at
    all. And where they see one segment on both sides, that takes back a share `a` of what a crease costs. An edge whose
    ends no image sees together has the neutral r of eq. 6, 1 - r_o: dearer than one within what images see as one.

    Args:
        crease: [E] c in [0, 1].
        disagreement: [E] r in [0, 1].
        weight: w.
        agreement: a in [0, 1].
    """
    return crease * (1 - agreement * (1 - disagreement)) + weight * (1 - crease) * disagreement
