"""connected_components: the slow twin, and arguments that are right and wrong."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from reference.arguments import EDGES, changed, large_graph
from torchjoint.ops import connected_components

EXAMPLE: dict[str, Any] = {"edge_index": EDGES, "num_nodes": 4}
ERRORS = [
    ({"edge_index": [[0], [1]]}, TypeError, "edge_index: expected a torch.Tensor, got list"),
    ({"edge_index": EDGES.int()}, TypeError, "edge_index: expected dtype torch.int64, got torch.int32"),
    ({"edge_index": EDGES.t()}, ValueError, "edge_index: expected shape [2, E], got [3, 2]"),
    ({"edge_index": EDGES[0]}, ValueError, "edge_index: expected shape [2, E], got [3]"),
    ({"edge_index": EDGES.to("meta")}, ValueError, "edge_index: expected a CPU tensor, got one on meta"),
    ({"edge_index": EDGES.to_sparse()}, TypeError, "edge_index: expected a dense tensor"),
    ({"edge_index": changed(EDGES, 4, 1, 2)}, ValueError, "numbers in [0, 4), got 4 at edge 2"),
    ({"edge_index": changed(EDGES, -1, 0, 1)}, ValueError, "numbers in [0, 4), got -1 at edge 1"),
    ({"edge_index": changed(EDGES, 2**40, 0, 1)}, ValueError, f"got {2**40} at edge 1"),
    ({"num_nodes": 0}, ValueError, "edge_index: expected node numbers in [0, 0), got 0 at edge 0"),
    ({"num_nodes": -1}, ValueError, "num_nodes: expected a number >= 0, got -1"),
    ({"num_nodes": 4.0}, TypeError, "num_nodes: expected int, got float"),
    ({"num_nodes": True}, TypeError, "num_nodes: expected int, got bool"),
    ({"num_nodes": 2**31}, ValueError, "num_nodes: expected less than 2^31, got 2147483648"),
]
REFUSED = [{"edge_index": EDGES.int()}, {"edge_index": EDGES.t()}, {"num_nodes": -1}, {"num_nodes": 2**31}]


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


def long_call(share: float = 1) -> Callable[[], Any]:
    """A call that takes some tenths of a second, or about such a share of that."""
    edges, _ = large_graph(int(3_000_000 * share))
    return lambda: connected_components(edges, edges.shape[1])
