"""group_summaries: the slow twin, and arguments that are right and wrong."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from reference.arguments import EDGES, EYE, NAN, PIXELS, POSITIONS
from torchjoint.ops.internal import ascending_order, group_summaries

EXAMPLE: dict[str, Any] = {
    "values": POSITIONS, "order": PIXELS.int(), "group": torch.tensor([0, -1, 1]), "num_groups": 2,
    "quantiles": torch.tensor([0.5, 1.0]),
}  # fmt: skip
ERRORS = [
    ({"values": POSITIONS.double()}, ValueError, "values: expected another dtype"),
    ({"order": PIXELS[:2].int()}, ValueError, "order: expected length 3 in dimension 0, got 2"),
    ({"order": PIXELS}, ValueError, "order: expected another dtype"),
    ({"order": PIXELS.int() + 1}, ValueError, "order: expected numbers in [0, 3), got 3 at 2"),
    ({"order": PIXELS.int() * 0}, ValueError, "order: expected a permutation, got 0 again at 1"),
    (
        {"order": PIXELS.int().flip(0), "group": PIXELS // 2},
        ValueError,
        "order: expected ascending values in each group, got a smaller one at 2",
    ),
    ({"group": PIXELS - 2}, ValueError, "group: expected numbers in [0, 2), got -2 at 0"),
    ({"group": PIXELS + 1}, ValueError, "group: expected numbers in [0, 2), got 2 at 1"),
    ({"num_groups": -1}, ValueError, "num_groups: expected 0 to 2^31 - 1, got -1"),
    ({"quantiles": POSITIONS}, ValueError, "quantiles: expected numbers in [0, 1], got 2 at 2"),
    ({"quantiles": POSITIONS * NAN}, ValueError, "quantiles: expected numbers in [0, 1], got nan"),
]
REFUSED = [
    {"values": EDGES},
    {"order": PIXELS[:2].int()},
    {"num_groups": -1},
    {"quantiles": EYE},
]


def group_summaries_reference(
    values: Tensor, order: Tensor, group: Tensor, num_groups: int, quantiles: Tensor
) -> Tensor:
    """What :func:`internal.group_summaries` computes, by sorting each group; the arguments are not checked."""
    result = torch.full((num_groups, 1 + len(quantiles)), torch.nan, dtype=torch.float64)
    for number in range(num_groups):
        inside = values[(group == number) & values.isfinite()]
        if len(inside):
            total = 0.0
            for value in inside.tolist():
                total += value
            places = (quantiles * (len(inside) - 1)).round().long()
            result[number, 0] = total / len(inside)
            result[number, 1:] = inside.sort().values[places].double()
    return result


def long_call(share: float = 1) -> Callable[[], Any]:
    """A call that takes some tenths of a second, or about such a share of that."""
    values = torch.rand(int(3_000_000 * share), generator=torch.Generator().manual_seed(0))
    order, group = ascending_order(values), torch.arange(len(values)) % 1000
    return lambda: group_summaries(values, order, group, 1000, torch.tensor([0.5]))
