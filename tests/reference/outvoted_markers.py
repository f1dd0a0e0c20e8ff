"""outvoted_markers: the slow twin, and arguments that are right and wrong."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from reference.arguments import LABELS, NAN
from torchjoint.ops.internal import outvoted_markers

EXAMPLE: dict[str, Any] = {
    "markers": LABELS, "colors": torch.rand(3, 3, 4), "color_weight": 9.0, "num_voters": 3, "near": 3.0,
}  # fmt: skip
ERRORS = [
    ({"markers": LABELS[0]}, ValueError, "markers: expected 2 dimensions"),
    ({"colors": torch.ones(3, 4)}, ValueError, "colors: expected 3 dimensions"),
    ({"colors": torch.full((3, 3, 4), NAN)}, ValueError, "colors: expected numbers in [0, 1], got"),
    ({"color_weight": torch.inf}, ValueError, "color_weight: expected 0 to 1000, got inf"),
    ({"num_voters": 0}, ValueError, "num_voters: expected 1 to 2^31 - 1, got 0"),
    ({"near": -1.0}, ValueError, "near: expected a finite number >= 0, got -1"),
]
REFUSED = [
    {"markers": LABELS.long()},
    {"colors": torch.rand(3, 4)},
    {"near": NAN},
]


def outvoted_markers_reference(
    markers: Tensor, colors: Tensor, color_weight: float, num_voters: int, near: float
) -> Tensor:
    """What :func:`torchjoint.ops.internal.outvoted_markers` computes; the arguments are not checked."""
    outvoted = torch.zeros(markers.shape, dtype=torch.bool)
    pixel = torch.nonzero(markers >= 0)
    row, column = pixel.T
    label, place = markers[row, column], torch.cat([pixel.T, color_weight * colors[:, row, column]]).double()
    side = near * math.sqrt(markers.numel() / max(len(label), 1))
    side = max(1, math.ceil(min(side, max(markers.shape))))  # larger cells say nothing new
    for i in range(len(label)):
        same = label == label[i]
        if same[((pixel // side - pixel[i] // side).abs() <= 1).all(1)].all():
            continue
        down, right, red, green, blue = (place - place[:, i, None]).square()
        distance = (((down + right) + red) + green) + blue
        distance[i] = math.inf
        in_order = distance.sort().values
        votes = distance < (in_order[num_voters] if len(label) > num_voters else math.inf)
        agree, others = int((votes & same).sum()), int(same.sum()) - 1
        outvoted[row[i], column[i]] = 2 * agree < min(int(votes.sum()), others)
    return outvoted


def long_call(share: float = 1) -> Callable[[], Any]:
    """A call that takes some tenths of a second, or about such a share of that."""
    side = share**0.5
    generator = torch.Generator().manual_seed(0)
    colors = torch.rand(3, int(400 * side), int(400 * side), generator=generator)
    return lambda: outvoted_markers((10 * colors[0]).int(), colors, 10.0, 12, 3.0)
