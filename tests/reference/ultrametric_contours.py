"""ultrametric_contours: the slow twin, and arguments that are right and wrong."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from reference.arguments import IMAGES, LABELS, NAN, changed

EXAMPLE: dict[str, Any] = {"boundary": IMAGES[0, 0], "relief": IMAGES[0, 1]}
ERRORS = [
    ({"boundary": IMAGES[0]}, ValueError, "boundary: expected shape [H, W], got [3, 2, 4]"),
    ({"boundary": LABELS}, TypeError, "boundary: expected dtype torch.float32, got torch.int32"),
    ({"boundary": IMAGES[0, 0] + 0.9}, ValueError, "boundary: expected numbers in [0, 1], got 1."),
    ({"boundary": IMAGES[0, 0] * NAN}, ValueError, "numbers in [0, 1], got nan at 0"),
    ({"relief": IMAGES[0, 0].T}, ValueError, "relief: expected shape [H, W] = [2, 4], got [4, 2]"),
    ({"relief": changed(IMAGES[0, 0], NAN, 1, 1)}, ValueError, "expected no NaN, got NaN at 5"),
]
REFUSED = [
    {"boundary": IMAGES[0]},
    {"relief": IMAGES[0, 0].T},
    {"relief": IMAGES[0, 0].double()},
]

#: The two regions on the sides of a region boundary, each named by its lowest pixel.
Sides = frozenset[tuple[int, int]]


def ultrametric_contours_reference(boundary: Tensor, relief: Tensor) -> Tensor:
    """What :func:`torchjoint.ops.ultrametric_contours` computes; the arguments are not checked."""
    height, width = boundary.shape
    level = torch.round(boundary.double() * 65535).long().tolist()
    low = relief.tolist()
    inside = {(row, column) for row in range(height) for column in range(width)}

    def basin(pixel: tuple[int, int]) -> tuple[int, int]:
        while True:
            square = [(pixel[0] + down, pixel[1] + right) for down in (-1, 0, 1) for right in (-1, 0, 1)]
            lowest = min((low[row][column], (row, column)) for row, column in square if (row, column) in inside)[1]
            if lowest == pixel:
                return pixel
            pixel = lowest

    region = {pixel: basin(pixel) for pixel in sorted(inside)}
    pairs = [
        (here, there)
        for down, right in ((0, 1), (1, 0), (1, 1), (-1, 1))
        for here in sorted(inside)
        if (there := (here[0] + down, here[1] + right)) in inside and region[here] != region[there]
    ]
    strengths: dict[Sides, list[int]] = {}
    for here, there in pairs:
        strongest = max(level[here[0]][here[1]], level[there[0]][there[1]])
        strengths.setdefault(frozenset((region[here], region[there])), []).append(strongest)
    number = {sides: i for i, sides in enumerate(strengths)}
    parts = {sides: [sides] for sides in strengths}

    heights: dict[Sides, float] = {}
    reached = 0.0
    while strengths:
        weakest = min(strengths, key=lambda sides: (sum(strengths[sides]) / len(strengths[sides]), number[sides]))
        reached = max(reached, sum(strengths[weakest]) / len(strengths[weakest]))
        heights |= dict.fromkeys(parts[weakest], reached)
        del strengths[weakest]
        kept, given = weakest
        for sides in [sides for sides in strengths if given in sides]:
            now = sides - {given} | {kept}
            is_joined = now in strengths
            number[now] = min(number[now], number[sides]) if is_joined else number[sides]
            parts[now] = parts[now] + parts[sides] if is_joined else parts[sides]
            strengths[now] = strengths.get(now, []) + strengths.pop(sides)

    contours = torch.zeros(height, width)
    for here, there in pairs:
        value = heights[frozenset((region[here], region[there]))] / 65535
        for pixel in (here, there):
            contours[pixel] = max(contours[pixel].item(), torch.tensor(value).item())
    return contours
