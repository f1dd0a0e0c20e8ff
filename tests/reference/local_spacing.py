"""local_spacing: the slow twin, and arguments that are right and wrong."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from reference.arguments import NAN, POINTS, changed
from torchjoint.ops.internal import local_spacing

REACH = torch.tensor([3.0, 1.0, 1.2, 0.0], dtype=torch.float64)
EXAMPLE: dict[str, Any] = {"points": POINTS, "reach": REACH, "share": 0.5, "count": 2}
ERRORS = [
    ({"points": POINTS.double()}, ValueError, "points: expected another dtype"),
    ({"points": POINTS[:, :2]}, ValueError, "points: expected length 3 in dimension 1, got 2"),
    ({"points": changed(POINTS, NAN, 2, 0)}, ValueError, "points: expected finite coordinates, got nan in row 2"),
    ({"reach": REACH[:3]}, ValueError, "reach: expected length 4 in dimension 0, got 3"),
    ({"reach": -REACH}, ValueError, "reach: expected finite numbers >= 0, got -3 at 0"),
    ({"share": 1.5}, ValueError, "share: expected a number in [0, 1], got 1.5"),
    ({"count": 0}, ValueError, "count: expected a number in [1, 8], got 0"),
    ({"count": 9}, ValueError, "count: expected a number in [1, 8], got 9"),
]
REFUSED = [{"points": POINTS.double()}, {"reach": REACH[:3]}, {"share": NAN}, {"count": 9}]


def local_spacing_reference(points: Tensor, reach: Tensor, share: float, count: int) -> Tensor:
    """What :func:`torchjoint.ops.internal.local_spacing` does; the arguments are not checked."""
    found = []
    for i, point in enumerate(points.double()):
        x, y, z = (points.double() - point).unbind(1)
        squared = (x.square() + y.square()) + z.square()
        squared[i] = math.inf
        nearest = [math.sqrt(value) for value in squared.sort().values[:count].tolist()]
        mean = sum(nearest, 0.0) / count if len(nearest) == count else math.inf
        own = float(reach[i])
        found.append(0.0 if mean <= share * own else mean if mean <= own else math.inf)
    return torch.tensor(found, dtype=torch.float64)


def long_call(share: float = 1) -> Callable[[], Any]:
    points = torch.rand(round(share * 120_000), 3, generator=torch.Generator().manual_seed(0))
    reach = torch.full((len(points),), 0.05, dtype=torch.float64)
    return lambda: local_spacing(points, reach, 0.1, 4)
