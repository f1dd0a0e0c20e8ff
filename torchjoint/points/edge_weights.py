"""Step 3: the geometric weight of the edges of the point graph (eq. 3)."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from torchjoint.config import PointGraphConfig
from torchjoint.points._vectors import by_columns, dot, length, rounded_length, rows_of
from torchjoint.points.normals import angle_between, is_convex
from torchjoint.runtime.threads import parallel_map

#: Edges that are worked on at a time, so that clouds of millions of points need little memory beyond the result.
EDGES = 1 << 16


#: How much a surface turns from one point to another: from the normals at both ends [E, 3], whether both are
#: oriented [E], and the step p_j - p_i between them [E, 3], to [E].
Turn = Callable[[Tensor, Tensor, Tensor, Tensor], Tensor]


def discounted_angle(convex_factor: float) -> Turn:
    """Theta, which counts `convex_factor` times where the surface is known to be convex."""

    def turn(first: Tensor, second: Tensor, oriented: Tensor, step: Tensor) -> Tensor:
        angle = angle_between(first, second, oriented)
        if convex_factor == 1:
            return angle
        return torch.where(oriented & is_convex(step, second - first), convex_factor * angle, angle)

    return turn


def geometric_weights(
    points: Tensor,
    edge_index: Tensor,
    normals: Tensor,
    oriented: Tensor,
    config: PointGraphConfig,
    colors: Tensor | None = None,
    turn: Turn | None = None,
) -> Tensor:
    """The part of eq. 3 that needs no image: w_d |p_i - p_j| + w_theta theta (+ a colour term, where asked for).

    Where both normals' signs are known and the surface is convex, theta counts `convex_factor` times (our own addition;
    1 is the paper's letter).

    Args:
        points: [N, 3] metres.
        edge_index: [2, E].
        normals: [N, 3] unit length.
        oriented: [N] bool, whether a normal's sign is known.
        colors: [N, 3] RGB in [0, 1], needed if config.color_weight > 0.
        turn: another measure than theta of how much the surface turns along an edge.

    Returns:
        [E] float32.

    Raises:
        ValueError: the config weighs colour and there is none.
    """
    turn = turn or discounted_angle(config.convex_factor)
    if config.color_weight > 0 and colors is None:
        raise ValueError("colors: point_graph.color_weight > 0 needs the colours of the points, got none")
    points, normals = by_columns(points), by_columns(normals)
    colors = None if colors is None else by_columns(colors)

    def weigh(edges: Tensor) -> Tensor:
        i, j = edges
        both_oriented = oriented[i] & oriented[j]
        first, second = rows_of(normals, i), rows_of(normals, j)
        step = rows_of(points, j) - rows_of(points, i)
        weight = config.angle_weight * turn(first, second, both_oriented, step)
        if config.distance_weight > 0:
            weight = weight + config.distance_weight * length(step)
        if config.color_weight > 0 and colors is not None:
            weight = weight + config.color_weight * length(rows_of(colors, i) - rows_of(colors, j))
        return weight

    return map_edges(weigh, edge_index)


def map_edges(weigh: Callable[[Tensor], Tensor], edge_index: Tensor) -> Tensor:
    """Weights of edges, some at a time on each thread: what is in between stays in the processor's cache.

    Args:
        weigh: from edges [2, e] to their weights [e] float32.
        edge_index: [2, E].
    """
    weights = torch.empty(edge_index.shape[1])
    starts = range(0, edge_index.shape[1], EDGES)

    def weigh_some(start: int) -> None:
        weights[start : start + EDGES] = weigh(edge_index[:, start : start + EDGES])

    parallel_map(weigh_some, starts)
    return weights


def segmentator_turn(first: Tensor, second: Tensor, oriented: Tensor, step: Tensor) -> Tensor:
    """1 - n_i . n_j, squared where the surface is convex: n_j . (p_j - p_i) > 0, which depends on the edge's direction.

    Where the normals' signs are not known: 1 - |n_i . n_j|.

    Args:
        first, second: [E, 3] normals n_i and n_j.
        oriented: [E] bool, whether the signs of both normals mean something.
        step: [E, 3] p_j - p_i.

    Returns:
        [E] float32.
    """
    cosine = dot(first, second)
    convex = oriented & (dot(second, step / rounded_length(step)[:, None]) > 0)
    weight = 1 - torch.where(oriented, cosine, cosine.abs())
    return torch.where(convex, weight * weight, weight)
