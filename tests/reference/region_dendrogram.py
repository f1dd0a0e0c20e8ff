"""region_dendrogram: the slow twin, and arguments that are right and wrong."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from reference.arguments import EDGES, NAN, VALUES, changed, large_graph
from torchjoint.ops import region_dendrogram

EXAMPLE: dict[str, Any] = {
    "edge_index": EDGES, "cost": VALUES, "num_regions": 4, "threshold": 0.5, "count": torch.tensor([1, 2, 1]),
}  # fmt: skip
ERRORS = [
    ({"edge_index": EDGES.int()}, TypeError, "edge_index: expected dtype torch.int64, got torch.int32"),
    ({"edge_index": changed(EDGES, 4, 1, 2)}, ValueError, "numbers in [0, 4), got 4 at edge 2"),
    ({"cost": VALUES.double()}, TypeError, "cost: expected dtype torch.float32, got torch.float64"),
    ({"cost": VALUES[:2]}, ValueError, "cost: expected shape [E] = [3], got [2]"),
    ({"cost": changed(VALUES, NAN, 1)}, ValueError, "cost: expected numbers in [0, 1024], got nan at"),
    ({"num_regions": -1}, ValueError, "num_regions: expected a number >= 0, got -1"),
    ({"num_regions": 4.0}, TypeError, "num_regions: expected int, got float"),
    ({"num_regions": 2**31}, ValueError, "num_regions: expected 0 to 2^31 - 1, got 2147483648"),
    ({"threshold": -0.1}, ValueError, "threshold: expected a number >= 0, got -0.1"),
    ({"threshold": "1"}, TypeError, "threshold: expected int or float, got str"),
    ({"count": torch.tensor([1.0, 2, 3])}, TypeError, "count: expected dtype torch.int64, got torch.float32"),
    ({"count": torch.tensor([1, 2])}, ValueError, "count: expected shape [E] = [3], got [2]"),
    ({"count": torch.tensor([1, 0, 2])}, ValueError, "count: expected numbers in [1, 2^31 - 1], got 0 at edge 1"),
]
REFUSED = [
    {"edge_index": EDGES.t()},
    {"cost": VALUES.double()},
    {"num_regions": -1},
    {"threshold": NAN},
    {"count": torch.tensor([1, -1, 2])},
]


def region_dendrogram_reference(
    edge_index: Tensor, cost: Tensor, num_regions: int, threshold: float, count: Tensor | None = None
) -> tuple[Tensor, Tensor]:
    """What :func:`torchjoint.ops.region_dendrogram` computes; the arguments are not checked.

    Example:
        >>> edge_index = torch.tensor([[0, 1, 0], [1, 2, 2]])
        >>> region_dendrogram_reference(edge_index, torch.tensor([0.0, 0.25, 0.75]), 3, 1.0)
        (tensor([[0, 0],
                [1, 2]]), tensor([0.0000, 0.5000], dtype=torch.float64))
    """
    # Sum of the costs and number of edges of each boundary, by the lowest regions of its two groups.
    costs: dict[tuple[int, int], tuple[float, int]] = {}
    counts = [1] * len(cost) if count is None else count.tolist()
    for (a, b), value, times in zip(edge_index.t().tolist(), cost.double().tolist(), counts, strict=True):
        if a != b:
            total, edges = costs.get((min(a, b), max(a, b)), (0.0, 0))
            costs[min(a, b), max(a, b)] = total + round(value * 2**20) * float(times), edges + times
    number = {pair: i for i, pair in enumerate(costs)}  # of each boundary
    merges: list[tuple[int, int]] = []
    means: list[float] = []
    while costs:
        mean, _, (kept, given) = min(
            (total / edges / 2**20, number[pair], pair) for pair, (total, edges) in costs.items()
        )
        if mean > threshold:
            break
        merges.append((kept, given))
        means.append(mean)
        del costs[kept, given]
        for old in [pair for pair in costs if given in pair]:
            other = old[0] + old[1] - given
            now = (min(kept, other), max(kept, other))
            number[now] = min(number[old], number[now]) if now in costs else number[old]
            (total, edges), (more, other_edges) = costs.get(now, (0.0, 0)), costs.pop(old)
            costs[now] = total + more, edges + other_edges
    return torch.tensor(merges, dtype=torch.int64).view(-1, 2).t(), torch.tensor(means, dtype=torch.float64)


def long_call(share: float = 1) -> Callable[[], Any]:
    """A call that takes some tenths of a second, or about such a share of that."""
    edges, cost = large_graph(int(100_000 * share))
    return lambda: region_dendrogram(edges, cost, len(cost), 0.4)
