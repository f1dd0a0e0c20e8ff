"""pair_counts: the slow twin, and arguments that are right and wrong."""

from __future__ import annotations

from collections import Counter
from itertools import combinations
from typing import Any

import torch
from torch import Tensor

from reference.arguments import NAN, PIXELS, POSITIONS, changed

EXAMPLE: dict[str, Any] = {
    "u": POSITIONS, "v": POSITIONS, "pixel": PIXELS, "segment": torch.tensor([0, 0, -1]),
    "label": torch.tensor([3, 4, 3]), "radius": 2.0,
}  # fmt: skip
ERRORS = [
    ({"u": PIXELS}, ValueError, "u: expected another dtype"),
    ({"u": changed(POSITIONS, NAN, 1)}, ValueError, "u: expected finite numbers, got nan at 1"),
    ({"v": changed(POSITIONS, torch.inf, 1)}, ValueError, "v: expected finite numbers, got inf at 1"),
    ({"v": POSITIONS[:2]}, ValueError, "v: expected length 3 in dimension 0, got 2"),
    ({"pixel": PIXELS - 1}, ValueError, "pixel: expected numbers in [0, 2147483647), got -1 at 0"),
    ({"segment": PIXELS - 2}, ValueError, "segment: expected numbers in [0, 2147483647), got -2 at 0"),
    ({"label": PIXELS + 2**40}, ValueError, f"label: expected numbers in [0, 2147483647), got {2**40}"),
    ({"radius": 0}, ValueError, "radius: expected a finite number > 0, got 0"),
    ({"radius": "1"}, RuntimeError, "Expected a value of type 'float' for argument 'radius'"),
]
REFUSED = [
    {"segment": PIXELS[:2]},
    {"radius": NAN},
]


def pair_counts_reference(
    u: Tensor, v: Tensor, pixel: Tensor, segment: Tensor, label: Tensor, radius: float
) -> tuple[Tensor, Tensor]:
    """What :func:`internal.pair_counts` computes, by testing all pairs; the arguments are not checked."""
    counts: Counter[tuple[int, ...]] = Counter()
    points = list(zip(u.tolist(), v.tolist(), pixel.tolist(), segment.tolist(), label.tolist(), strict=True))
    for (u1, v1, pixel1, segment1, label1), (u2, v2, pixel2, segment2, label2) in combinations(points, 2):
        is_near = (u1 - u2) * (u1 - u2) + (v1 - v2) * (v1 - v2) <= radius * radius
        is_alike = segment1 == segment2 and label1 == label2
        if is_near and not is_alike and pixel1 != pixel2 and segment1 >= 0 and segment2 >= 0:
            counts[*sorted((segment1, segment2)), *sorted((label1, label2))] += 1
    groups = sorted(counts)
    rows = torch.tensor(groups, dtype=torch.int64).reshape(-1, 4)
    return rows.T.contiguous(), torch.tensor([counts[group] for group in groups], dtype=torch.int64)
