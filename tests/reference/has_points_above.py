"""has_points_above: the slow twin, and arguments that are right and wrong."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from reference.arguments import NAN, changed

COLUMN = torch.tensor([0, 5, 3, 0])
HEIGHT = torch.tensor([0.0, 0.5, 0.5, 3.0], dtype=torch.float64)
EXAMPLE: dict[str, Any] = {
    "column": COLUMN, "row": torch.tensor([1, 2, 1, 1]), "height": HEIGHT, "used": torch.ones(4, dtype=torch.bool),
    "which": torch.tensor([0, 2]), "num_columns": 6, "num_rows": 3, "least": 0.25, "most": 2.5,
}  # fmt: skip
ERRORS = [
    ({"column": COLUMN.int()}, ValueError, "column: expected another dtype"),
    ({"column": changed(COLUMN, 6, 1)}, ValueError, "column: expected numbers in [0, 6), got 6 at 1"),
    ({"row": COLUMN}, ValueError, "row: expected numbers in [0, 3), got 5 at 1"),
    ({"row": COLUMN[:2]}, ValueError, "row: expected length 4 in dimension 0, got 2"),
    ({"height": changed(HEIGHT, NAN, 2)}, ValueError, "height: expected finite numbers, got nan at 2"),
    ({"used": COLUMN}, ValueError, "used: expected another dtype"),
    ({"which": torch.tensor([4])}, ValueError, "which: expected numbers in [0, 4), got 4 at 0"),
    ({"num_columns": 0}, ValueError, "num_columns: expected a number > 0, got 0"),
    ({"num_rows": 2**31}, ValueError, "num_rows: expected less than 2^31 cells"),
    ({"least": -1.0}, ValueError, "least: expected a number >= 0, got -1.0"),
]
REFUSED = [{"column": COLUMN.int()}, {"height": HEIGHT[:1]}, {"which": torch.tensor([-1])}, {"num_rows": -1}]


def has_points_above_reference(
    column: Tensor,
    row: Tensor,
    height: Tensor,
    used: Tensor,
    which: Tensor,
    num_columns: int,
    num_rows: int,
    least: float,
    most: float,
) -> Tensor:
    """What :func:`torchjoint.ops.internal.has_points_above` does; the arguments are not checked."""
    found = []
    for i in which.tolist():
        aside = (column - column[i]) % num_columns
        is_near = ((aside <= 1) | (aside == num_columns - 1)) & ((row - row[i]).abs() <= 1)
        over = height - height[i]
        found.append(bool((is_near & used & (over > least) & (over < most)).any()))
    return torch.tensor(found, dtype=torch.bool)
