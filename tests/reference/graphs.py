"""Reference versions of the graph algorithms (steps 2, 6 and 7); shapes and units are those of the operators."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
import torch
from torch import Tensor


def connected_components_reference(edge_index: Tensor, num_nodes: int) -> Tensor:
    """What :func:`torchjoint.ops.connected_components` computes, breadth first; the arguments are not checked.

    Example:
        >>> connected_components_reference(torch.tensor([[3, 1], [0, 4]]), num_nodes=5)
        tensor([0, 1, 2, 0, 1])
    """
    neighbors: list[list[int]] = [[] for _ in range(num_nodes)]
    for u, v in edge_index.t().tolist():
        neighbors[u].append(v)
        neighbors[v].append(u)
    labels, num_components = [-1] * num_nodes, 0
    for first in range(num_nodes):
        if labels[first] >= 0:
            continue
        labels[first], reached = num_components, deque([first])
        while reached:
            for node in neighbors[reached.popleft()]:
                if labels[node] < 0:
                    labels[node] = num_components
                    reached.append(node)
        num_components += 1
    return torch.tensor(labels, dtype=torch.int64)


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
    """The integer capacities that :func:`torchjoint.ops.min_cut` uses: of the edges, and source minus sink per node.

    The differences are not limited here, because Python's integers do not overflow.

    Args:
        capacity: ``[E]``, finite, >= 0.
        source_capacity, sink_capacity: ``[N]``, >= 0, may be infinite.

    Returns:
        E and N integers, in a unit that is a power of two.
    """
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
    """What :func:`torchjoint.ops.min_cut` computes, by shortest augmenting paths (Edmonds and Karp).

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
        """The nodes that the source reaches, each with its predecessor."""
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
