"""splat_depth: the slow twin, and arguments that are right and wrong."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from reference.arguments import NAN, PIXELS, POSITIONS, changed

EXAMPLE: dict[str, Any] = {
    "row": PIXELS, "column": PIXELS, "depth": POSITIONS, "reach": torch.tensor([0, 1, 2]), "height": 3, "width": 4,
}  # fmt: skip
ERRORS = [
    ({"row": PIXELS[None]}, ValueError, "row: expected shape [M], got [1, 3]"),
    ({"row": PIXELS + 1}, ValueError, "row: expected numbers in [0, 3), got 3 at 2"),
    ({"column": PIXELS - 1}, ValueError, "column: expected numbers in [0, 4), got -1 at 0"),
    ({"column": PIXELS[:2]}, ValueError, "column: expected shape [M] = [3], got [2]"),
    ({"depth": PIXELS}, TypeError, "depth: expected dtype torch.float32, got torch.int64"),
    ({"depth": changed(POSITIONS, NAN, 1)}, ValueError, "depth: expected no NaN, got NaN at 1"),
    ({"reach": PIXELS - 1}, ValueError, "reach: expected numbers in [0, 2147483647), got -1 at 0"),
    ({"height": -1}, ValueError, "height: expected a number >= 0, got -1"),
    ({"height": 2**20, "width": 2**20}, ValueError, "expected an image of at most 2^31 - 1 pixels"),
]
REFUSED = [
    {"row": torch.tensor(0)},
    {"column": PIXELS[:2]},
    {"reach": PIXELS.int()},
    {"height": -1},
]


def splat_depth_reference(row: Tensor, column: Tensor, depth: Tensor, reach: Tensor, height: int, width: int) -> Tensor:
    """What :func:`torchjoint.ops.splat_depth` computes; the arguments are not checked."""
    nearest = torch.full((height, width), torch.inf)
    for r, c, z, k in zip(row.tolist(), column.tolist(), depth, reach.tolist(), strict=True):
        square = nearest[max(r - k, 0) : r + k + 1, max(c - k, 0) : c + k + 1]
        square.copy_(torch.minimum(square, z))
    return nearest
