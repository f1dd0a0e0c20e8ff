"""merge_regions: the slow twin, and arguments that are right and wrong."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from reference.arguments import EDGES, NAN, PIXELS, VALUES, changed, large_graph
from torchjoint.ops import merge_regions

EXAMPLE: dict[str, Any] = {
    "edge_index": EDGES, "cost": VALUES, "size": torch.tensor([9, 1, 2, 3]), "threshold": 0.5, "min_size": 2,
    "by_size": True,
}  # fmt: skip
ERRORS = [
    ({"edge_index": EDGES.int()}, TypeError, "edge_index: expected dtype torch.int64, got torch.int32"),
    ({"edge_index": EDGES.t()}, ValueError, "edge_index: expected shape [2, E], got [3, 2]"),
    ({"edge_index": changed(EDGES, 4, 1, 2)}, ValueError, "numbers in [0, 4), got 4 at edge 2"),
    ({"edge_index": changed(EDGES, -1, 0, 1)}, ValueError, "numbers in [0, 4), got -1 at edge 1"),
    ({"cost": VALUES.double()}, TypeError, "cost: expected dtype torch.float32, got torch.float64"),
    ({"cost": VALUES[:2]}, ValueError, "cost: expected shape [E] = [3], got [2]"),
    ({"cost": changed(VALUES, NAN, 1)}, ValueError, "cost: expected numbers in [0, 1024], got nan at"),
    ({"cost": -VALUES}, ValueError, "cost: expected numbers in [0, 1024], got -0.1 at edge 0"),
    ({"cost": VALUES + 1024}, ValueError, "cost: expected numbers in [0, 1024], got 1024.1 at edge 0"),
    ({"size": torch.ones(4)}, TypeError, "size: expected dtype torch.int64, got torch.float32"),
    ({"size": PIXELS[None]}, ValueError, "size: expected shape [R], got [1, 3]"),
    ({"size": torch.tensor([9, 1, -2, 3])}, ValueError, "size: expected numbers >= 0, got -2 at 2"),
    ({"threshold": -0.1}, ValueError, "threshold: expected a number >= 0, got -0.1"),
    ({"threshold": NAN}, ValueError, "threshold: expected a number >= 0, got nan"),
    ({"threshold": "1"}, TypeError, "threshold: expected int or float, got str"),
    ({"min_size": 1.5}, TypeError, "min_size: expected int, got float"),
    ({"min_size": -1}, ValueError, "min_size: expected a number >= 0, got -1"),
]
REFUSED = [
    {"edge_index": EDGES.int()},
    {"cost": VALUES[:2]},
    {"cost": VALUES.double()},
    {"size": PIXELS[None]},
    {"threshold": NAN},
    {"min_size": -1},
]


def merge_regions_reference(
    edge_index: Tensor, cost: Tensor, size: Tensor, threshold: float, min_size: int = 0, *, by_size: bool = False
) -> Tensor:
    """What :func:`torchjoint.ops.merge_regions` computes; the arguments are not checked.

    Example:
        >>> edge_index = torch.tensor([[0, 0, 1, 1], [1, 1, 2, 2]])
        >>> merge_regions_reference(edge_index, torch.tensor([0.0, 0.2, 0.1, 0.9]), torch.ones(3).long(), 0.3)
        tensor([0, 0, 1])
    """
    group = [[region] for region in range(len(size))]  # for each region, the regions merged into it
    costs: dict[frozenset[int], list[float]] = {}  # costs of each boundary, by the first regions of its two groups
    for (a, b), value in zip(edge_index.t().tolist(), cost.double().tolist(), strict=True):
        if a != b:
            costs.setdefault(frozenset((a, b)), []).append(round(value * 2**20) / 2**20)
    number = {sides: i for i, sides in enumerate(costs)}

    def mean(sides: frozenset[int]) -> float:
        return sum(costs[sides]) / len(costs[sides])

    def total(region: int) -> int:
        return sum(int(size[member]) for member in group[region])

    def cost_of(sides: frozenset[int], is_small: bool) -> float:
        a, b = map(total, sides)
        return mean(sides) * (a * b / max(a + b, 1) if by_size and not is_small else 1)

    def merge(sides: frozenset[int]) -> None:
        kept, given = sorted(sides)
        group[kept] += group[given]
        group[given] = []
        del costs[sides]
        for old in [other for other in costs if given in other]:
            now = old - {given} | {kept}
            number[now] = min(number.get(now, number[old]), number[old]) if now in costs else number[old]
            costs[now] = costs.get(now, []) + costs.pop(old)

    for is_small in (False, True):
        while True:
            may_merge = [
                sides
                for sides in costs
                if (
                    any(total(region) < min_size for region in sides)
                    if is_small
                    else cost_of(sides, False) <= threshold
                )
            ]
            if not may_merge:
                break
            merge(min(may_merge, key=lambda sides: (cost_of(sides, is_small), number[sides])))
    labels = torch.empty(len(size), dtype=torch.int64)
    for label, members in enumerate(members for members in group if members):
        labels[members] = label
    return labels


def long_call(share: float = 1) -> Callable[[], Any]:
    """A call that takes some tenths of a second, or about such a share of that."""
    edges, cost = large_graph(int(100_000 * share))
    return lambda: merge_regions(edges, cost, torch.ones(len(cost), dtype=torch.int64), 0.4, 2)
