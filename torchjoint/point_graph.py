"""Step 3: the graph of the cloud's nearest neighbours, normals, and the geometric weight of its edges."""

from __future__ import annotations

from typing import NamedTuple

import torch
from scipy.spatial import cKDTree
from torch import Tensor

from torchjoint.config import PointGraphConfig
from torchjoint.scene import Scene


class Neighbors(NamedTuple):
    """K nearest neighbours of every point, nearest first, the point itself left out."""

    indices: Tensor  #: [N, K] int64
    distances: Tensor  #: [N, K] float32, metres

    @property
    def spacing(self) -> Tensor:
        """[N] metres: how far a point is from its closest few neighbours, a measure of the local density."""
        few = self.distances[:, :4]
        return few.mean(dim=1) if few.shape[1] else few.new_zeros(few.shape[0])


class PointGraph(NamedTuple):
    """The cloud as a graph, with all that depends on no image."""

    points: Tensor  #: [N, 3]
    colors: Tensor | None  #: [N, 3]
    normals: Tensor  #: [N, 3] unit length, of any sign
    normals_are_given: bool  #: and so their signs mean something where no camera sees the point
    spacing: Tensor  #: [N] metres
    edge_index: Tensor  #: [2, E]

    @property
    def num_points(self) -> int:
        """N."""
        return self.points.shape[0]

    def is_same(self, other: PointGraph) -> bool:
        """Whether both are of the same points with the same normals."""
        return torch.equal(self.points, other.points) and torch.equal(self.normals, other.normals)


def build_point_graph(cloud: Scene, config: PointGraphConfig) -> PointGraph:
    """Neighbours, edges and normals of a cloud (its frames are not looked at)."""
    count = config.neighbors if cloud.normals is not None else max(config.neighbors, config.normal_neighbors)
    neighbors = nearest_neighbors(cloud.points, count)
    normals = cloud.normals
    if normals is None:
        normals = estimate_normals(cloud.points, neighbors.indices[:, : config.normal_neighbors])
    return PointGraph(
        cloud.points,
        cloud.colors,
        normals,
        cloud.normals is not None,
        neighbors.spacing,
        undirected_edges(neighbors.indices[:, : config.neighbors]),
    )


def nearest_neighbors(points: Tensor, count: int) -> Neighbors:
    """The `count` nearest neighbours of each point (all others, where the cloud has fewer).

    Duplicate points are neighbours at distance 0 of one another.

    Args:
        points: [N, 3] float32.
        count: K >= 1.
    """
    num_points = points.shape[0]
    count = min(count, num_points - 1)
    if count == 0:
        return Neighbors(torch.zeros(num_points, 0, dtype=torch.int64), torch.zeros(num_points, 0))
    coordinates = points.numpy()
    tree = cKDTree(coordinates, balanced_tree=False, compact_nodes=False)
    distance, index = tree.query(coordinates, k=count + 1, workers=-1)
    index_t, distance_t = torch.from_numpy(index), torch.from_numpy(distance).float()
    # The point itself usually comes first, but among duplicates any of them may: drop it, or else the farthest.
    is_self = index_t == torch.arange(num_points)[:, None]
    is_self[:, -1] |= ~is_self.any(dim=1)
    keep = ~is_self
    return Neighbors(index_t[keep].view(num_points, count), distance_t[keep].view(num_points, count))


def undirected_edges(neighbors: Tensor) -> Tensor:
    """The edges of the symmetrised neighbour graph, each once with i < j (eq. 3).

    Args:
        neighbors: [N, K] int64.

    Returns:
        [2, E] int64, in the order in which rows of `neighbors` name them.
    """
    num_points, count = neighbors.shape
    source = torch.arange(num_points)[:, None].expand(-1, count)
    # (i, j) with i > j would be the second mention of an edge if j names i as well.
    backward = source > neighbors
    rows, targets = source[backward], neighbors[backward]
    keep = torch.ones_like(backward)
    keep[backward] = ~(neighbors[targets] == rows[:, None]).any(dim=1)
    i, j = source[keep], neighbors[keep]
    return torch.stack([torch.minimum(i, j), torch.maximum(i, j)])


def estimate_normals(points: Tensor, neighbors: Tensor, chunk: int = 16384) -> Tensor:
    """Normals of the planes fitted to each point and its neighbours; their sign is arbitrary.

    Args:
        points: [N, 3] float32.
        neighbors: [N, K] int64. With K < 2 a plane is not defined and the normal is (0, 0, 1).

    Returns:
        [N, 3] float32, unit length.
    """
    if neighbors.shape[1] < 2:
        return points.new_tensor([0.0, 0.0, 1.0]).repeat(points.shape[0], 1)
    normals = []
    for start in range(0, points.shape[0], chunk):
        # Relative to the point itself: centred coordinates keep float32 accurate far from the origin.
        rows = neighbors[start : start + chunk]
        around = points[rows] - points[start : start + chunk, None]
        around = torch.cat([torch.zeros_like(around[:, :1]), around], dim=1).double()
        around = around - around.mean(dim=1, keepdim=True)
        _, vectors = torch.linalg.eigh(around.transpose(1, 2) @ around)
        normals.append(vectors[:, :, 0].float())
    return torch.cat(normals)


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


def geometric_weights(
    points: Tensor,
    edge_index: Tensor,
    normals: Tensor,
    oriented: Tensor,
    config: PointGraphConfig,
    colors: Tensor | None = None,
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

    Returns:
        [E] float32.

    Raises:
        ValueError: the config weighs colour and there is none.
    """
    i, j = edge_index
    known = oriented[i] & oriented[j]
    angle = angle_between(normals[i], normals[j], known)
    if config.convex_factor < 1:
        convex = known & is_convex(points[j] - points[i], normals[j] - normals[i])
        angle = torch.where(convex, config.convex_factor * angle, angle)
    weight = config.angle_weight * angle
    if config.distance_weight > 0:
        weight = weight + config.distance_weight * _distance(points[i], points[j])
    if config.color_weight > 0:
        if colors is None:
            raise ValueError("colors: point_graph.color_weight > 0 needs the colours of the points, got none")
        weight = weight + config.color_weight * _distance(colors[i], colors[j])
    return weight


def _distance(first: Tensor, second: Tensor) -> Tensor:
    x, y, z = (first - second).square().unbind(1)
    return ((x + y) + z).sqrt()
