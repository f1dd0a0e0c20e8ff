"""Step 3: the graph of the cloud's nearest neighbours, normals, and the geometric weight of its edges."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint import ops
from torchjoint.config import PointGraphConfig
from torchjoint.neighbors import neighbor_tables
from torchjoint.scene import Scene
from torchjoint.threads import all_threads, map_frames

#: Edges that are worked on at a time, so that clouds of millions of points need little memory beyond the result.
EDGES = 1 << 16


class PointGraph(NamedTuple):
    """The cloud as a graph, with all that depends on no image."""

    points: Tensor  #: [N, 3]
    colors: Tensor | None  #: [N, 3]
    normals: Tensor  #: [N, 3] unit length, of any sign
    normals_are_given: bool  #: and so their signs mean something where no camera sees the point
    spacing: Tensor  #: [N] metres
    edge_index: Tensor  #: [2, E]
    neighbors: Tensor  #: [N, K] int32, nearest first, that planes are fitted to

    @property
    def num_points(self) -> int:
        """N."""
        return self.points.shape[0]

    def is_same(self, other: PointGraph) -> bool:
        """Whether both are of the same points with the same normals."""
        return torch.equal(self.points, other.points) and torch.equal(self.normals, other.normals)


def build_point_graph(cloud: Scene, config: PointGraphConfig) -> PointGraph:
    """Neighbours, edges and normals of a cloud (its frames are not looked at)."""
    for_normals = config.normal_neighbors if cloud.normals is None else 0
    counts = (config.neighbors, for_normals, config.plane_neighbors)
    table, spacing = neighbor_tables(cloud.points, counts, config.reach)
    normals = cloud.normals
    if normals is None:
        normals = estimate_normals(cloud.points, table[for_normals])
    return PointGraph(
        cloud.points,
        cloud.colors,
        normals,
        cloud.normals is not None,
        spacing,
        undirected_edges(table[config.neighbors]),
        table[config.plane_neighbors].contiguous(),
    )


def undirected_edges(neighbors: Tensor) -> Tensor:
    """The edges of the symmetrised neighbour graph, each once with i < j (eq. 3).

    Args:
        neighbors: [N, K] int32 or int64.

    Returns:
        [2, E] int64, in the order in which rows of `neighbors` name them.
    """
    with all_threads():
        return ops.neighbor_edges(neighbors)


def estimate_normals(points: Tensor, neighbors: Tensor) -> Tensor:
    """Normals of the planes fitted to each point and its neighbours; their sign is arbitrary.

    Args:
        points: [N, 3] float32.
        neighbors: [N, K] int32 or int64. With K < 2 a plane is not defined and the normal is (0, 0, 1).

    Returns:
        [N, 3] float32, unit length.
    """
    with all_threads():
        return ops.fit_normals(points, neighbors)


def faces_camera(graph: PointGraph, point: Tensor, world_to_camera: Tensor) -> Tensor:
    """[M] int64, for each of the points [M]: 1 where its normal shows to the camera's side, -1 where away from it."""
    center = -(world_to_camera[:3, :3].T @ world_to_camera[:3, 3]).float()
    x, y, z = (graph.normals[point] * (center - graph.points[point])).unbind(1)
    return ((x + y) + z).sign().long()


def orient_normals(graph: PointGraph, facing: Tensor) -> tuple[Tensor, Tensor]:
    """Turns normals to the cameras: a surface is seen from outside.

    Args:
        facing: [N] sum of :func:`faces_camera` over the images that see a point.

    Returns:
        normals [N, 3], and whether each one's sign is known, [N] bool.
    """
    if graph.normals_are_given:  # the cameras know better than a file, but a file better than nobody
        facing = torch.where(facing == 0, 1, facing)
    return torch.where(facing[:, None] < 0, -graph.normals, graph.normals), facing != 0


def angle_between(first: Tensor, second: Tensor, oriented: Tensor) -> Tensor:
    """Angle of two normals, theta = atan2(|n_i x n_j|, n_i . n_j), radians (eq. 4).

    Args:
        first, second: [E, 3].
        oriented: [E] bool; where False the signs mean nothing, and the angle is that of the two lines, at most pi/2.

    Returns:
        [E] float32 in [0, pi].
    """
    x1, y1, z1 = first.unbind(1)
    x2, y2, z2 = second.unbind(1)
    dot = (x1 * x2 + y1 * y2) + z1 * z2
    cross = ((y1 * z2 - z1 * y2).square() + (z1 * x2 - x1 * z2).square()) + (x1 * y2 - y1 * x2).square()
    return torch.atan2(cross.sqrt(), torch.where(oriented, dot, dot.abs()))


def is_convex(step: Tensor, turn: Tensor) -> Tensor:
    """Whether the surface bends away from its normals between two points: (n_j - n_i) . (p_j - p_i) > 0.

    Args:
        step: [E, 3] p_j - p_i.
        turn: [E, 3] n_j - n_i, of normals that show outwards.
    """
    x, y, z = (step * turn).unbind(1)
    return (x + y) + z > 0


#: How much a surface turns from one point to another: from the normals at both ends [E, 3], whether their signs are
#: known [E], and the way p_j - p_i between them [E, 3], to [E].
Turn = Callable[[Tensor, Tensor, Tensor, Tensor], Tensor]


def discounted_angle(convex_factor: float) -> Turn:
    """Theta, which counts `convex_factor` times where the surface is known to be convex."""

    def turn(first: Tensor, second: Tensor, known: Tensor, step: Tensor) -> Tensor:
        angle = angle_between(first, second, known)
        if convex_factor == 1:
            return angle
        return torch.where(known & is_convex(step, second - first), convex_factor * angle, angle)

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
        known = oriented[i] & oriented[j]
        first, second = rows_of(normals, i), rows_of(normals, j)
        step = rows_of(points, j) - rows_of(points, i)
        weight = config.angle_weight * turn(first, second, known, step)
        if config.distance_weight > 0:
            weight = weight + config.distance_weight * _length(step)
        if config.color_weight > 0 and colors is not None:
            weight = weight + config.color_weight * _length(rows_of(colors, i) - rows_of(colors, j))
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

    map_frames(weigh_some, starts)
    return weights


def by_columns(vectors: Tensor) -> Tensor:
    """The same [N, 3], but each column in one piece of memory: columns are what is calculated with."""
    return vectors.T.contiguous().T


def rows_of(vectors: Tensor, index: Tensor) -> Tensor:
    """``vectors[index]``, [E, 3], of and into the layout of :func:`by_columns`."""
    return torch.stack([column.index_select(0, index) for column in vectors.unbind(1)]).T


def _length(vectors: Tensor) -> Tensor:
    x, y, z = vectors.square().unbind(1)
    return ((x + y) + z).sqrt()
