"""felzenszwalb: the slow twin, and arguments that are right and wrong."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch import Tensor

from reference.arguments import EDGES, NAN, VALUES, changed, large_graph
from torchjoint.ops import felzenszwalb

EXAMPLE: dict[str, Any] = {"edge_index": EDGES, "weight": VALUES, "num_nodes": 4, "scale": 1.0, "min_size": 0}
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
    ({"weight": None}, TypeError, "weight: expected a torch.Tensor, got NoneType"),
    ({"weight": VALUES.half()}, TypeError, "weight: expected dtype torch.float32 or torch.float64, got"),
    ({"weight": VALUES[:2]}, ValueError, "weight: expected shape [E] = [3], got [2]"),
    ({"weight": VALUES[None]}, ValueError, "weight: expected shape [E] = [3], got [1, 3]"),
    ({"weight": VALUES.to("meta")}, ValueError, "weight: expected a CPU tensor, got one on meta"),
    ({"weight": changed(VALUES, NAN, 1)}, ValueError, "weight: expected no NaN, got NaN at edge 1"),
    ({"num_nodes": -1}, ValueError, "num_nodes: expected a number >= 0, got -1"),
    ({"num_nodes": 4.0}, TypeError, "num_nodes: expected int, got float"),
    ({"num_nodes": True}, TypeError, "num_nodes: expected int, got bool"),
    ({"num_nodes": 2**31}, ValueError, "num_nodes: expected less than 2^31, got 2147483648"),
    ({"scale": -0.5}, ValueError, "scale: expected a number >= 0, got -0.5"),
    ({"scale": NAN}, ValueError, "scale: expected a number >= 0, got nan"),
    ({"scale": "1"}, TypeError, "scale: expected int or float, got str"),
    ({"min_size": -1}, ValueError, "min_size: expected a number >= 0, got -1"),
    ({"min_size": 1.5}, TypeError, "min_size: expected int, got float"),
]
REFUSED = [
    {"edge_index": EDGES.int()},
    {"edge_index": EDGES.t()},
    {"weight": VALUES.half()},
    {"weight": VALUES[:2]},
    {"num_nodes": -1},
    {"num_nodes": 2**31},
    {"scale": NAN},
    {"min_size": -1},
]


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


def long_call(share: float = 1) -> Callable[[], Any]:
    """A call that takes some tenths of a second, or about such a share of that."""
    edges, weight = large_graph(int(3_000_000 * share))
    return lambda: felzenszwalb(edges, weight, len(weight), 1.0)
