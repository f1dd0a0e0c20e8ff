"""ascending_order: the slow twin, and arguments that are right and wrong."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor

from reference.arguments import EDGES, POSITIONS

EXAMPLE: dict[str, Any] = {"values": POSITIONS}
ERRORS = [
    ({"values": POSITIONS.double()}, ValueError, "values: expected another dtype"),
    ({"values": POSITIONS[None]}, ValueError, "values: expected 1 dimensions"),
]
REFUSED = [
    {"values": EDGES},
]


def ascending_order_reference(values: Tensor) -> Tensor:
    """What :func:`torchjoint.ops.internal.ascending_order` computes, by comparisons; the argument is not checked."""
    numbers = values.tolist()
    missing = [math.isnan(number) for number in numbers]
    order = sorted(range(len(numbers)), key=lambda i: (missing[i], 0.0 if missing[i] else numbers[i], i))
    return torch.tensor(order, dtype=torch.int32)
