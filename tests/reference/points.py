"""Reference versions of the operators on points and pixels (steps 3, 4, 5 and 7).

Shapes and units are those of the operators.
"""

from __future__ import annotations

from collections import Counter
from itertools import combinations

import torch
from torch import Tensor


def nearest_neighbors_reference(points: Tensor, count: int, num_distances: int | None = None) -> tuple[Tensor, Tensor]:
    """What :func:`torchjoint.ops.nearest_neighbors` computes, by sorting all distances; the arguments are not checked.

    Example:
        >>> nearest_neighbors_reference(torch.tensor([[0.0, 0, 0], [1, 0, 0], [3, 0, 0]]), 1)[0].tolist()
        [[1], [0], [1]]
    """
    x, y, z = (points.double()[:, None] - points.double()).unbind(dim=2)
    squared = (x * x + y * y) + z * z
    itself = torch.eye(len(points), dtype=torch.bool)
    # A stable sort leaves equal distances in the order of the numbers; then the point itself is left out.
    order = squared.sort(dim=1, stable=True).indices
    order = order[~itself.gather(1, order)].view(len(points), max(len(points) - 1, 0))[:, :count]
    distances = squared.gather(1, order[:, : count if num_distances is None else num_distances]).sqrt()
    return order.int(), distances.to(points.dtype)


def neighbor_edges_reference(neighbors: Tensor, order: Tensor | None = None) -> Tensor:
    """What :func:`torchjoint.ops.neighbor_edges` computes; the arguments are not checked, and the order does not count.

    Example:
        >>> neighbor_edges_reference(torch.tensor([[1], [0], [1]]))
        tensor([[0, 1],
                [1, 2]])
    """
    num_points, count = neighbors.shape
    neighbors = neighbors.long()
    source = torch.arange(num_points)[:, None].expand(-1, count)
    # (i, j) with i > j is the second occurrence of an edge if i is also in the row of j.
    backward = source > neighbors
    rows, targets = source[backward], neighbors[backward]
    keep = source != neighbors
    keep[backward] = ~(neighbors[targets] == rows[:, None]).any(dim=1)
    i, j = source[keep], neighbors[keep]
    return torch.stack([torch.minimum(i, j), torch.maximum(i, j)])


def fit_normals_reference(points: Tensor, neighbors: Tensor, order: Tensor | None = None) -> Tensor:
    """What :func:`torchjoint.ops.fit_normals` computes; the arguments are not checked, and the order does not count.

    If a neighbourhood varies least in more than one direction, the result may be any of these directions.

    Example:
        >>> points = torch.tensor([[0.0, 0, 0], [0, 0, 1], [0, 2, 0]])
        >>> fit_normals_reference(points, torch.tensor([[1, 2], [0, 2], [0, 1]])).abs()
        tensor([[1., 0., 0.],
                [1., 0., 0.],
                [1., 0., 0.]])
    """
    if neighbors.shape[1] < 2:
        return torch.tensor([0.0, 0.0, 1.0]).repeat(points.shape[0], 1)
    points = points.double()
    around = points[neighbors.long()] - points[:, None]
    around = torch.cat([torch.zeros_like(around[:, :1]), around], dim=1)
    around = around - around.mean(dim=1, keepdim=True)
    _, vectors = torch.linalg.eigh(around.transpose(1, 2) @ around)
    x, y, z = vectors[:, :, 0].float().unbind(dim=1)
    sign = torch.where(z != 0, z, torch.where(y != 0, y, x))
    return torch.where(sign[:, None] < 0, -vectors[:, :, 0], vectors[:, :, 0]).float()


def project_reference(
    points: Tensor,
    camera_from_world: Tensor,
    intrinsics: Tensor,
    near: float,
    far: float,
    height: int,
    width: int,
    margin: float = 0.0,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """What :func:`torchjoint.ops.project` computes; the arguments are not checked."""
    x, y, z = (
        ((row[0] * points[:, 0].double() + row[1] * points[:, 1].double()) + row[2] * points[:, 2].double()) + row[3]
        for row in camera_from_world[:3]
    )
    u = (intrinsics[0, 0] * x / z + intrinsics[0, 2]).float()
    v = (intrinsics[1, 1] * y / z + intrinsics[1, 2]).float()
    column, row = (u + 0.5).floor().double(), (v + 0.5).floor().double()
    inside = (column >= -margin) & (column < width + margin) & (row >= -margin) & (row < height + margin)
    point = torch.nonzero((z > near) & (z < far) & inside).squeeze(1)
    return point, u[point], v[point], z[point].float()


def splat_depth_reference(row: Tensor, column: Tensor, depth: Tensor, reach: Tensor, height: int, width: int) -> Tensor:
    """What :func:`torchjoint.ops.splat_depth` computes; the arguments are not checked."""
    nearest = torch.full((height, width), torch.inf)
    for r, c, z, k in zip(row.tolist(), column.tolist(), depth, reach.tolist(), strict=True):
        square = nearest[max(r - k, 0) : r + k + 1, max(c - k, 0) : c + k + 1]
        square.copy_(torch.minimum(square, z))
    return nearest


def window_overlaps_reference(
    order: Tensor,
    other_end: Tensor,
    start: Tensor,
    point: Tensor,
    row: Tensor,
    column: Tensor,
    labels: Tensor,
    window: int,
) -> tuple[Tensor, Tensor]:
    """What :func:`torchjoint.ops.window_overlaps` computes; the arguments are not checked."""
    reach = window // 2

    def around(r: int, c: int) -> Counter[int]:
        pixels = labels[max(r - reach, 0) : r + reach + 1, max(c - reach, 0) : c + reach + 1]
        return Counter(pixels[pixels >= 0].tolist())

    windows = {node: around(r, c) for node, r, c in zip(point.tolist(), row.tolist(), column.tolist(), strict=True)}
    edges, overlaps = [], []
    for node in point.tolist():
        for place in range(int(start[node]), int(start[node + 1])):
            first, second = windows[node], windows.get(int(other_end[place]), Counter())
            if first and second:
                edges.append(int(order[place]))
                overlaps.append((first & second).total() / min(first.total(), second.total()))
    return torch.tensor(edges, dtype=torch.int64), torch.tensor(overlaps, dtype=torch.float64)


def line_maxima_reference(
    order: Tensor, other_end: Tensor, start: Tensor, point: Tensor, row: Tensor, column: Tensor, image: Tensor
) -> tuple[Tensor, Tensor]:
    """What :func:`torchjoint.ops.line_maxima` computes; the arguments are not checked."""
    places = {node: torch.tensor(place) for node, *place in zip(*map(Tensor.tolist, (point, row, column)), strict=True)}
    edges, maxima = [], []
    for node in point.tolist():
        for place in range(int(start[node]), int(start[node + 1])):
            other = int(other_end[place])
            if other in places:
                line = (torch.lerp(places[node].double(), places[other].double(), step / 4) for step in range(5))
                edges.append(int(order[place]))
                maxima.append(max(int(image[tuple(pixel.round().long())]) for pixel in line))
    return torch.tensor(edges, dtype=torch.int64), torch.tensor(maxima, dtype=torch.uint8)


def pair_counts_reference(
    u: Tensor, v: Tensor, pixel: Tensor, segment: Tensor, label: Tensor, radius: float
) -> tuple[Tensor, Tensor]:
    """What :func:`torchjoint.ops.pair_counts` computes, by testing all pairs; the arguments are not checked."""
    counts: Counter[tuple[int, ...]] = Counter()
    points = list(zip(u.tolist(), v.tolist(), pixel.tolist(), segment.tolist(), label.tolist(), strict=True))
    for (u1, v1, pixel1, segment1, label1), (u2, v2, pixel2, segment2, label2) in combinations(points, 2):
        is_near = (u1 - u2) * (u1 - u2) + (v1 - v2) * (v1 - v2) <= radius * radius
        is_alike = segment1 == segment2 and label1 == label2
        if is_near and not is_alike and pixel1 != pixel2 and segment1 >= 0 and segment2 >= 0:
            counts[*sorted((segment1, segment2)), *sorted((label1, label2))] += 1
    groups = sorted(counts)
    rows = torch.tensor(groups, dtype=torch.int64).reshape(-1, 4)
    return rows.T.contiguous(), torch.tensor([counts[group] for group in groups], dtype=torch.int64)
