"""propagate_labels: the slow twin, and arguments that are right and wrong."""

from __future__ import annotations

from collections.abc import Callable
from heapq import heappop, heappush
from typing import Any

import numpy as np
import torch
from torch import Tensor

from reference.arguments import LABELS, NAN
from torchjoint.ops import propagate_labels

EXAMPLE: dict[str, Any] = {
    "markers": LABELS, "colors": torch.rand(3, 3, 4), "boundary": torch.rand(3, 4), "color_weight": 9.0,
    "boundary_weight": 2.0, "min_markers": 2, "groups": torch.arange(9, dtype=torch.int32) // 2,
}  # fmt: skip
ERRORS = [
    ({"markers": LABELS.long()}, TypeError, "markers: expected dtype torch.int32, got torch.int64"),
    ({"colors": torch.rand(1, 3, 4)}, ValueError, "colors: expected shape [3, H, W] = [3, 3, 4], got"),
    ({"colors": torch.full((3, 3, 4), NAN)}, ValueError, "colors: expected numbers in [0, 1], got nan"),
    ({"boundary": torch.ones(3)}, ValueError, "boundary: expected shape [H, W] = [3, 4], got [3]"),
    ({"boundary": torch.full((3, 4), 1.5)}, ValueError, "boundary: expected numbers in [0, 1], got 1.5"),
    ({"color_weight": -1.0}, ValueError, "color_weight: expected a number >= 0, got -1.0"),
    ({"groups": torch.arange(9)}, TypeError, "groups: expected dtype torch.int32, got torch.int64"),
    (
        {"groups": torch.zeros(1, dtype=torch.int32)},
        ValueError,
        "groups: expected one for each label of a marker, got 1",
    ),
    ({"groups": torch.full((9,), -1).int()}, ValueError, "groups: expected numbers >= 0, got a negative one"),
    ({"boundary_weight": 1001.0}, ValueError, "boundary_weight: expected 0 to 1000, got 1001"),
]
REFUSED = [
    {"markers": LABELS.long()},
    {"colors": torch.rand(3, 4, 3)},
    {"boundary": torch.rand(3)},
    {"boundary_weight": NAN},
]


def propagate_labels_reference(
    markers: Tensor,
    colors: Tensor,
    boundary: Tensor,
    color_weight: float,
    boundary_weight: float,
    min_markers: int = 1,
    groups: Tensor | None = None,
) -> Tensor:
    """What :func:`torchjoint.ops.propagate_labels` computes; the arguments are not checked."""
    image = colors, boundary, color_weight, boundary_weight
    if not (markers >= 0).any():
        return markers.clone()
    labels = _cheapest_labels(markers, *image)
    parts = _connected_parts(labels if groups is None else groups[labels.long()])
    stays = [sum(bool(markers[pixel] >= 0) for pixel in part) >= min_markers for part in parts]
    if not any(stays):
        return labels
    kept = labels.clone()
    for part, stay in zip(parts, stays, strict=True):
        for pixel in part if not stay else ():
            kept[pixel] = -1
    return _cheapest_labels(kept, *image)


def _connected_parts(labels: Tensor) -> list[list[tuple[int, int]]]:
    """The pixels (row, column) of each connected part of one label, 8-neighbourhood."""
    parts: list[list[tuple[int, int]]] = []
    left = {(row, column) for row in range(labels.shape[0]) for column in range(labels.shape[1])}
    while left:
        part = [left.pop()]
        for row, column in part:
            for there in ((row + down, column + right) for down in (-1, 0, 1) for right in (-1, 0, 1)):
                if there in left and labels[there] == labels[row, column]:
                    left.remove(there)
                    part.append(there)
        parts.append(part)
    return parts


def _cheapest_labels(
    markers: Tensor, colors: Tensor, boundary: Tensor, color_weight: float, boundary_weight: float
) -> Tensor:
    height, width = markers.shape
    red, green, blue = colors.numpy()
    strength = boundary.numpy()
    weights = np.float32(color_weight), np.float32(boundary_weight)
    labels = torch.full_like(markers, -1)
    queue = [(0, int(markers[row, column]), row, column) for row, column in torch.nonzero(markers >= 0).tolist()]
    queue.sort()
    while queue:
        cost, label, row, column = heappop(queue)
        if labels[row, column] >= 0:
            continue
        labels[row, column] = label
        here = row, column
        for down, right in ((0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (-1, 1), (1, -1), (-1, -1)):
            there = row + down, column + right
            if not (0 <= there[0] < height and 0 <= there[1] < width):
                continue
            differences = [plane[here] - plane[there] for plane in (red, green, blue)]
            squares = [difference * difference for difference in differences]
            distance = np.sqrt((squares[0] + squares[1]) + squares[2])
            length = np.float32(1.41421356 if down and right else 1)
            weakest = min(strength[here], strength[there])
            step = np.rint(np.float32(8) * ((length + weights[0] * distance) + weights[1] * weakest))
            heappush(queue, (cost + int(step), label, *there))
    return labels


def long_call(share: float = 1) -> Callable[[], Any]:
    """A call that takes some tenths of a second, or about such a share of that."""
    side = share**0.5
    generator = torch.Generator().manual_seed(0)
    image = torch.rand(4, int(1000 * side), int(1000 * side), generator=generator)
    markers = torch.where(image[0] < 0.01, torch.arange(image.shape[2]), -1).int()
    return lambda: propagate_labels(markers, image[:3], image[3], 9.0, 2.0)
