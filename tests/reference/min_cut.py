"""min_cut: the slow twin, and arguments that are right and wrong."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from reference.arguments import EDGES, NAN, SINK, SOURCE, VALUES, changed, large_graph
from torchjoint.ops import min_cut

EXAMPLE: dict[str, Any] = {"edge_index": EDGES, "capacity": VALUES, "source_capacity": SOURCE, "sink_capacity": SINK}
ERRORS = [
    ({"edge_index": EDGES.float()}, TypeError, "edge_index: expected dtype torch.int64, got torch.float32"),
    ({"edge_index": EDGES.t()}, ValueError, "edge_index: expected shape [2, E], got [3, 2]"),
    ({"edge_index": changed(EDGES, 4, 1, 2)}, ValueError, "numbers in [0, 4), got 4 at edge 2"),
    ({"edge_index": changed(EDGES, -7, 1, 0)}, ValueError, "numbers in [0, 4), got -7 at edge 0"),
    ({"capacity": VALUES.long()}, TypeError, "capacity: expected dtype torch.float32 or torch.float64, got"),
    ({"capacity": VALUES[1:]}, ValueError, "capacity: expected shape [E] = [3], got [2]"),
    ({"capacity": -VALUES}, ValueError, "capacity: expected finite numbers >= 0, got -0.1 at edge 0"),
    ({"capacity": changed(VALUES, NAN, 2)}, ValueError, "capacity: expected finite numbers >= 0, got nan"),
    ({"capacity": changed(VALUES, torch.inf, 2)}, ValueError, "numbers >= 0, got inf at edge 2"),
    ({"source_capacity": SOURCE[None]}, ValueError, "source_capacity: expected shape [N], got [1, 4]"),
    ({"source_capacity": SOURCE - 1}, ValueError, "source_capacity: expected numbers >= 0, got -1 at node 1"),
    ({"source_capacity": SOURCE.bool()}, TypeError, "source_capacity: expected dtype torch.float32 or"),
    ({"sink_capacity": SINK[:3]}, ValueError, "sink_capacity: expected shape [N] = [4], got [3]"),
    ({"sink_capacity": changed(SINK, NAN, 1)}, ValueError, "sink_capacity: expected numbers >= 0, got nan"),
    ({"sink_capacity": SOURCE}, ValueError, "source_capacity and sink_capacity: both are infinite at node 0"),
]
REFUSED = [
    {"capacity": VALUES[:2]},
    {"sink_capacity": SINK[:2]},
    {"source_capacity": SOURCE[None]},
]


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


def long_call(share: float = 1) -> Callable[[], Any]:
    """A call that takes some tenths of a second, or about such a share of that."""
    edges, capacity = large_graph(int(1_000_000 * share))
    return lambda: min_cut(edges, capacity, 9 * capacity, 9 * capacity.flip(0))
