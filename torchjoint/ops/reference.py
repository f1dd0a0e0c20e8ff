"""The slow, obvious twins of the compiled operators: the tests' oracle, and the place to read what they compute."""

from __future__ import annotations

import math
from collections import Counter, deque
from itertools import combinations

import numpy as np
import torch
from torch import Tensor


def felzenszwalb_reference(
    edge_index: Tensor, weight: Tensor, num_nodes: int, scale: float, min_size: int = 0
) -> Tensor:
    """What :func:`torchjoint.ops.felzenszwalb` computes, without union-find or radix sort.

    Shapes, units and meaning are those of the operator; the arguments are not checked.

    Example:
        >>> edge_index = torch.tensor([[0, 1, 2], [1, 2, 3]])
        >>> felzenszwalb_reference(edge_index, torch.tensor([0.1, 5.0, 0.2]), num_nodes=4, scale=1.0)
        tensor([0, 0, 1, 1])
    """
    weights = weight.to(torch.float32)
    k = np.float32(scale)
    component = list(range(num_nodes))  # of each node
    members = [[node] for node in range(num_nodes)]  # of each component
    threshold = [k] * num_nodes  # Int(C) + k / |C|

    def join(a: int, b: int) -> None:
        for node in members[b]:
            component[node] = a
        members[a] += members[b]
        members[b] = []

    edges = [
        (int(edge_index[0, e]), int(edge_index[1, e]), np.float32(float(weights[e])))
        for e in torch.argsort(weights, stable=True).tolist()
    ]
    with np.errstate(over="ignore", invalid="ignore"):  # infinite weights and scales are allowed
        for u, v, w in edges:
            a, b = component[u], component[v]
            if a != b and w <= threshold[a] and w <= threshold[b]:
                join(a, b)
                threshold[a] = w + k / np.float32(len(members[a]))

    for u, v, _ in edges:
        a, b = component[u], component[v]
        if a != b and min(len(members[a]), len(members[b])) < min_size:
            join(a, b)

    number: dict[int, int] = {}
    labels = [number.setdefault(component[node], len(number)) for node in range(num_nodes)]
    return torch.tensor(labels, dtype=torch.int64)


def quantise_reference(capacity: Tensor, source_capacity: Tensor, sink_capacity: Tensor) -> tuple[list[int], list[int]]:
    """The integers that :func:`torchjoint.ops.min_cut` calculates with: the capacities of the edges, and at each node
    source minus sink capacity. The latter is not limited here: Python's integers do not overflow.
    """  # noqa: D205
    largest = max(capacity.tolist(), default=0.0)
    unit_exponent = min(60 - len(capacity).bit_length() - math.frexp(largest)[1], 1000)
    unit = math.ldexp(1.0, unit_exponent)
    enough = 2**80  # more than all edges together

    def quantise(value: float) -> int:
        if value == 0:
            return 0
        scaled = abs(value) * unit
        magnitude = enough if scaled >= enough else max(round(scaled), 1)
        return magnitude if value > 0 else -magnitude

    difference = source_capacity.to(torch.float64) - sink_capacity.to(torch.float64)
    return [quantise(c) for c in capacity.tolist()], [quantise(d) for d in difference.tolist()]


def min_cut_reference(
    edge_index: Tensor, capacity: Tensor, source_capacity: Tensor, sink_capacity: Tensor
) -> tuple[Tensor, Tensor]:
    """What :func:`torchjoint.ops.min_cut` computes, by the shortest augmenting paths of Edmonds and Karp.

    Shapes, units and meaning are those of the operator; the arguments are not checked.

    Example:
        >>> edge_index = torch.tensor([[0, 1, 2], [1, 2, 3]])
        >>> source, sink = torch.tensor([9.0, 0.0, 0.0, 0.0]), torch.tensor([0.0, 0.0, 0.0, 9.0])
        >>> min_cut_reference(edge_index, torch.tensor([3.0, 1.0, 2.0]), source, sink)
        (tensor([ True,  True, False, False]), tensor(1., dtype=torch.float64))
    """
    num_nodes = len(source_capacity)
    source, sink = num_nodes, num_nodes + 1
    edges = edge_index.t().tolist()
    capacities, differences = quantise_reference(capacity, source_capacity, sink_capacity)

    residual: list[dict[int, int]] = [{} for _ in range(num_nodes + 2)]

    def add_arc(u: int, v: int, amount: int) -> None:
        residual[u][v] = residual[u].get(v, 0) + amount
        residual[v].setdefault(u, 0)

    for (u, v), c in zip(edges, capacities, strict=True):
        if u != v:
            add_arc(u, v, c)
            add_arc(v, u, c)
    for node, difference in enumerate(differences):
        add_arc(source, node, max(difference, 0))
        add_arc(node, sink, max(-difference, 0))

    def reach() -> dict[int, int]:
        """Every node the source reaches, with the node before it."""
        before = {source: source}
        queue = deque([source])
        while queue:
            u = queue.popleft()
            for v, amount in residual[u].items():
                if amount > 0 and v not in before:
                    before[v] = u
                    queue.append(v)
        return before

    while sink in (before := reach()):
        path, v = [], sink
        while v != source:
            path.append((before[v], v))
            v = before[v]
        amount = min(residual[u][v] for u, v in path)
        for u, v in path:
            residual[u][v] -= amount
            residual[v][u] += amount

    side = [node in before for node in range(num_nodes)]
    flow = 0.0
    for (u, v), c in zip(edges, capacity.tolist(), strict=True):
        flow += c if side[u] != side[v] else 0.0
    for inside, from_source, to_sink in zip(side, source_capacity.tolist(), sink_capacity.tolist(), strict=True):
        flow += to_sink if inside else from_source
    return torch.tensor(side, dtype=torch.bool), torch.tensor(flow, dtype=torch.float64)


def neighbor_edges_reference(neighbors: Tensor) -> Tensor:
    """What :func:`torchjoint.ops.neighbor_edges` computes; the arguments are not checked.

    Example:
        >>> neighbor_edges_reference(torch.tensor([[1], [0], [1]]))
        tensor([[0, 1],
                [1, 2]])
    """
    num_points, count = neighbors.shape
    neighbors = neighbors.long()
    source = torch.arange(num_points)[:, None].expand(-1, count)
    # (i, j) with i > j is the second mention of an edge if j names i as well.
    backward = source > neighbors
    rows, targets = source[backward], neighbors[backward]
    keep = source != neighbors
    keep[backward] = ~(neighbors[targets] == rows[:, None]).any(dim=1)
    i, j = source[keep], neighbors[keep]
    return torch.stack([torch.minimum(i, j), torch.maximum(i, j)])


def fit_normals_reference(points: Tensor, neighbors: Tensor) -> Tensor:
    """What :func:`torchjoint.ops.fit_normals` computes; the arguments are not checked.

    Where a neighbourhood has no one direction in which it varies least, any of them may come.

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


def pair_counts_reference(
    u: Tensor, v: Tensor, pixel: Tensor, segment: Tensor, label: Tensor, radius: float
) -> tuple[Tensor, Tensor]:
    """What :func:`torchjoint.ops.pair_counts` computes, by looking at all pairs; the arguments are not checked."""
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


def segment_graphs_reference(
    labels: Tensor, chosen: Tensor, colors: Tensor, boundary: Tensor, color_weight: float, boundary_weight: float
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """What :func:`torchjoint.ops.segment_graphs` computes; the arguments are not checked."""
    pixels: list[int] = []
    edges: list[tuple[int, int]] = []
    weights: list[float] = []
    node_ptr, edge_ptr = [0], [0]
    for segment in torch.nonzero(chosen).flatten().tolist():
        places = torch.nonzero(labels == segment).tolist()
        number = {tuple(place): i for i, place in enumerate(places)}
        own = []
        for down, right in ((0, 1), (1, 0), (1, 1), (-1, 1)):
            for i, (row, column) in enumerate(places):
                here, there = (row, column), (row + down, column + right)
                if there not in number:
                    continue
                red, green, blue = (colors[:, *here] - colors[:, *there]).square().numpy()
                distance = np.sqrt((red + green) + blue)  # numpy's is correctly rounded; torch's, through MKL, is not
                weakest = min(boundary[here].numpy(), boundary[there].numpy())
                own.append(float(np.float32(color_weight) * distance + np.float32(boundary_weight) * weakest))
                edges.append((i, number[there]))
        total = 0.0
        for weight in own:  # not sum(), which from Python 3.12 on is more precise than adding
            total += weight
        mean = total / max(len(own), 1)
        weights += [weight / mean if mean > 0 else weight for weight in own]
        pixels += [row * labels.shape[1] + column for row, column in places]
        node_ptr.append(len(pixels))
        edge_ptr.append(len(edges))
    edge_index = torch.tensor(edges, dtype=torch.int64).reshape(-1, 2).T.contiguous()
    relative_weight = torch.tensor(weights, dtype=torch.float64)
    return (
        torch.tensor(pixels, dtype=torch.int64),
        torch.tensor(node_ptr),
        edge_index,
        torch.tensor(edge_ptr),
        relative_weight,
    )
