"""Step 3: the geometric weight of the edges of the point graph (eq. 3)."""

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint.cloud.normals import angle_between, by_columns, dot, is_convex, length, rounded_length, rows_of
from torchjoint.runtime.threads import parallel_map

#: Number of edges processed at a time, so that intermediate results of large clouds need little memory.
EDGES = 1 << 16

#: Computes the step p_j - p_i [E, 3] along edges. Its rows are far apart in memory, so it is computed only if needed.
Step = Callable[[], Tensor]
#: Measures how much a surface turns along an edge: a function of the normals at both ends [E, 3], whether both are
#: oriented [E], and the step; returns [E].
Turn = Callable[[Tensor, Tensor, Tensor, Step], Tensor]


class EdgeWeights(NamedTuple):
    """The weights of eq. 3. Only their ratios to each other and to k have an effect, so w_theta can be 1."""

    turn: Turn  #: measures how much the surface turns along an edge: theta of eq. 3, or something in its place
    angle: float = 1.0  #: w_theta, weight of the turn
    distance: float = 0.0  #: w_d, per metre
    color: float = 0.0  #: w_c, weight of an RGB distance; not in the paper


def discounted_angle(convex_factor: float) -> Turn:
    """The turn theta, multiplied by `convex_factor` where the normals are oriented and the surface is convex."""

    def turn(first: Tensor, second: Tensor, oriented: Tensor, step: Step) -> Tensor:
        angle = angle_between(first, second, oriented)
        if convex_factor == 1:
            return angle
        return torch.where(oriented & is_convex(step(), second - first), convex_factor * angle, angle)

    return turn


def geometric_weights(
    points: Tensor,
    edge_index: Tensor,
    normals: Tensor,
    oriented: Tensor,
    weights: EdgeWeights,
    colors: Tensor | None = None,
) -> Tensor:
    """The part of eq. 3 without images: w_d |p_i - p_j| + w_theta theta + w_c |c_i - c_j|.

    Args:
        points: [N, 3] metres.
        edge_index: [2, E] int64.
        normals: [N, 3] unit length.
        oriented: [N] bool, whether a normal is oriented.
        weights: weights of the terms.
        colors: [N, 3] RGB in [0, 1], required if weights.color > 0.

    Returns:
        [E] float32.
    """
    if weights.color > 0 and colors is None:
        raise ValueError("colors: color_weight > 0 needs the colours of the points, got none")
    points, normals = by_columns(points), by_columns(normals)
    colors = None if colors is None else by_columns(colors)

    def weigh(edges: Tensor) -> Tensor:
        i, j = edges
        both_oriented = oriented[i] & oriented[j]
        first, second = rows_of(normals, i), rows_of(normals, j)
        step = cache(lambda: rows_of(points, j) - rows_of(points, i))
        weight = weights.angle * weights.turn(first, second, both_oriented, step)
        if weights.distance > 0:
            weight = weight + weights.distance * length(step())
        if weights.color > 0 and colors is not None:
            weight = weight + weights.color * length(rows_of(colors, i) - rows_of(colors, j))
        return weight

    return map_edges(weigh, edge_index)


def map_edges(weigh: Callable[[Tensor], Tensor], edge_index: Tensor) -> Tensor:
    """Computes weights of edges in blocks, on several threads: intermediate results stay in the processor's cache.

    Args:
        weigh: computes the weights [e] float32 of edges [2, e].
        edge_index: [2, E] int64.

    Returns:
        [E] float32.
    """
    weights = torch.empty(edge_index.shape[1], dtype=torch.float32)

    def weigh_some(start: int) -> None:
        weights[start : start + EDGES] = weigh(edge_index[:, start : start + EDGES])

    parallel_map(weigh_some, range(0, edge_index.shape[1], EDGES))
    return weights


def segmentator_turn(first: Tensor, second: Tensor, oriented: Tensor, step: Step) -> Tensor:
    """The edge weight of ScanNet's segmentator: 1 - n_i . n_j, squared where the surface is convex.

    The surface counts as convex where n_j . (p_j - p_i) > 0; this depends on the edge's direction. Where the normals
    are not oriented, the weight is 1 - |n_i . n_j|.

    Args:
        first, second: [E, 3] normals n_i and n_j.
        oriented: [E] bool, whether both normals are oriented.
        step: gives [E, 3] p_j - p_i, metres.

    Returns:
        [E] float32.
    """
    cosine = dot(first, second)
    convex = oriented & (dot(second, step() / rounded_length(step())[:, None]) > 0)
    weight = 1 - torch.where(oriented, cosine, cosine.abs())
    return torch.where(convex, weight * weight, weight)
