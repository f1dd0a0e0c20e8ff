"""line_maxima: the slow twin, and arguments that are right and wrong."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from reference.arguments import LABELS, PIXELS

EXAMPLE: dict[str, Any] = {
    "order": torch.tensor([0, 1, 2], dtype=torch.int32), "other_end": torch.tensor([1, 2, 3], dtype=torch.int32),
    "start": torch.tensor([0, 1, 2, 3, 3], dtype=torch.int32), "point": torch.tensor([0, 1, 3]), "row": PIXELS,
    "column": PIXELS, "image": LABELS.byte(),
}  # fmt: skip
ERRORS = [
    ({"order": PIXELS}, ValueError, "order: expected another dtype"),
    ({"other_end": PIXELS.int() - 1}, ValueError, "other_end: expected numbers in [0, 4), got -1 at 0"),
    ({"start": torch.tensor([0, 2, 1, 3, 3]).int()}, ValueError, "start: expected ascending numbers"),
    ({"point": torch.tensor([3, 1, 3])}, ValueError, "point: expected every point once, got 3 again at 2"),
    ({"row": PIXELS + 1}, ValueError, "row: expected numbers in [0, 3), got 3 at 2"),
    ({"column": PIXELS[:2]}, ValueError, "column: expected length 3 in dimension 0, got 2"),
    ({"image": LABELS}, ValueError, "image: expected another dtype"),
    ({"image": LABELS[0].byte()}, ValueError, "image: expected 2 dimensions"),
]
REFUSED = [{"start": PIXELS[:0].int()}, {"column": PIXELS[:2]}, {"image": LABELS}]


def line_maxima_reference(
    order: Tensor, other_end: Tensor, start: Tensor, point: Tensor, row: Tensor, column: Tensor, image: Tensor
) -> tuple[Tensor, Tensor]:
    """What :func:`torchjoint.ops.internal.line_maxima` computes; the arguments are not checked."""
    places = {node: torch.tensor(place) for node, *place in zip(*map(Tensor.tolist, (point, row, column)), strict=True)}
    edges, maxima = [], []
    for node in point.tolist():
        for place in range(int(start[node]), int(start[node + 1])):
            other = int(other_end[place])
            if other in places:
                line = (torch.lerp(places[node].double(), places[other].double(), step / 4) for step in range(5))
                edges.append(int(order[place]))
                maxima.append(max(int(image[tuple(pixel.round().long())]) for pixel in line))
    return torch.tensor(edges, dtype=torch.int64), torch.tensor(maxima, dtype=torch.uint8)
