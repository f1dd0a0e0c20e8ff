"""window_overlaps: the slow twin, and arguments that are right and wrong."""

from __future__ import annotations

from collections import Counter
from typing import Any

import torch
from torch import Tensor

from reference.arguments import LABELS, PIXELS

EXAMPLE: dict[str, Any] = {
    "order": torch.tensor([0, 1, 2], dtype=torch.int32), "other_end": torch.tensor([1, 2, 3], dtype=torch.int32),
    "start": torch.tensor([0, 1, 2, 3, 3], dtype=torch.int32), "point": torch.tensor([0, 1, 3]), "row": PIXELS,
    "column": PIXELS, "labels": LABELS, "window": 3,
}  # fmt: skip
ERRORS = [
    ({"order": PIXELS}, ValueError, "order: expected another dtype"),
    ({"other_end": PIXELS[:2].int()}, ValueError, "other_end: expected length 3 in dimension 0, got 2"),
    ({"other_end": PIXELS.int() - 1}, ValueError, "other_end: expected numbers in [0, 4), got -1 at 0"),
    ({"start": PIXELS[:0].int()}, ValueError, "start: expected shape [N + 1], got [0]"),
    ({"start": torch.tensor([0, 9, 9, 9, 9]).int()}, ValueError, "start: expected ascending numbers in [0, E]"),
    ({"point": torch.tensor([0, 1, 4])}, ValueError, "point: expected numbers in [0, 4), got 4 at 2"),
    ({"point": torch.tensor([0, 1, 0])}, ValueError, "point: expected every point once, got 0 again"),
    ({"row": PIXELS + 1}, ValueError, "row: expected numbers in [0, 3), got 3 at 2"),
    ({"column": PIXELS - 1}, ValueError, "column: expected numbers in [0, 4), got -1 at 0"),
    ({"labels": LABELS.long()}, ValueError, "labels: expected another dtype"),
    ({"window": 2}, ValueError, "window: expected an odd number below 32768, got 2"),
]
REFUSED = [
    {"order": PIXELS[:2].int()},
    {"row": PIXELS[:2]},
    {"labels": LABELS[0]},
    {"window": -1},
]


def window_overlaps_reference(
    order: Tensor,
    other_end: Tensor,
    start: Tensor,
    point: Tensor,
    row: Tensor,
    column: Tensor,
    labels: Tensor,
    window: int,
) -> tuple[Tensor, Tensor]:
    """What :func:`torchjoint.ops.internal.window_overlaps` computes; the arguments are not checked."""
    reach = window // 2

    def around(r: int, c: int) -> Counter[int]:
        pixels = labels[max(r - reach, 0) : r + reach + 1, max(c - reach, 0) : c + reach + 1]
        return Counter(pixels[pixels >= 0].tolist())

    windows = {node: around(r, c) for node, r, c in zip(point.tolist(), row.tolist(), column.tolist(), strict=True)}
    edges, overlaps = [], []
    for node in point.tolist():
        for place in range(int(start[node]), int(start[node + 1])):
            first, second = windows[node], windows.get(int(other_end[place]), Counter())
            if first and second:
                edges.append(int(order[place]))
                overlaps.append((first & second).total() / min(first.total(), second.total()))
    return torch.tensor(edges, dtype=torch.int64), torch.tensor(overlaps, dtype=torch.float64)
