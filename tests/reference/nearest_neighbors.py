"""nearest_neighbors: the slow twin, and arguments that are right and wrong."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from reference.arguments import NAN, POINTS, changed
from torchjoint.ops import nearest_neighbors

LIMITS = torch.tensor([0.0, 1.0, 2.0, torch.inf], dtype=torch.float64)
EXAMPLE: dict[str, Any] = {"points": POINTS, "count": 2, "num_distances": 1, "limits": LIMITS}
ERRORS = [
    ({"points": POINTS.numpy()}, TypeError, "points: expected a torch.Tensor, got ndarray"),
    ({"points": POINTS.half()}, TypeError, "points: expected dtype torch.float32 or torch.float64"),
    ({"points": POINTS[:, :2]}, ValueError, "points: expected shape [N, 3], got [4, 2]"),
    ({"points": changed(POINTS, NAN, 2, 1)}, ValueError, "finite coordinates, got nan in row 2"),
    ({"points": changed(POINTS, torch.inf, 3, 0)}, ValueError, "coordinates, got inf in row 3"),
    ({"count": -1}, ValueError, "count: expected a number >= 0, got -1"),
    ({"num_distances": 1.0}, TypeError, "num_distances: expected int, got float"),
    ({"limits": LIMITS.float()}, TypeError, "limits: expected dtype torch.float64, got torch.float32"),
    ({"limits": LIMITS[:3]}, ValueError, "limits: expected shape [N] = [4], got [3]"),
    ({"limits": changed(LIMITS, NAN, 1)}, ValueError, "limits: expected numbers >= 0, got nan at 1"),
]
REFUSED = [
    {"points": POINTS.half()},
    {"points": POINTS[:, :2]},
    {"count": -1},
    {"num_distances": -1},
    {"limits": LIMITS[:3]},
    {"limits": -LIMITS},
]


def nearest_neighbors_reference(
    points: Tensor, count: int, num_distances: int | None = None, limits: Tensor | None = None
) -> tuple[Tensor, Tensor]:
    """What :func:`torchjoint.ops.nearest_neighbors` computes, by sorting all distances; the arguments are not checked.

    Example:
        >>> nearest_neighbors_reference(torch.tensor([[0.0, 0, 0], [1, 0, 0], [3, 0, 0]]), 1)[0].tolist()
        [[1], [0], [1]]
    """
    places = torch.where(points.double().abs() < 1e-136, 0, points.double())
    x, y, z = (places[:, None] - places).unbind(dim=2)
    squared = (x * x + y * y) + z * z
    itself = torch.eye(len(points), dtype=torch.bool)
    # A stable sort leaves equal distances in the order of the numbers; then the point itself is left out.
    order = squared.sort(dim=1, stable=True).indices
    order = order[~itself.gather(1, order)].view(len(points), max(len(points) - 1, 0))[:, :count]
    found = squared.gather(1, order)
    far = found > (torch.inf if limits is None else limits.square()[:, None])
    order = torch.where(far, torch.arange(len(points))[:, None], order)
    distances = torch.where(far, torch.inf, found.sqrt())[:, : count if num_distances is None else num_distances]
    return order.int(), distances.to(points.dtype)


def long_call(share: float = 1) -> Callable[[], Any]:
    """A call that takes some tenths of a second, or about such a share of that."""
    points = torch.rand(int(200_000 * share), 3, generator=torch.Generator().manual_seed(0))
    return lambda: nearest_neighbors(points, 16)
