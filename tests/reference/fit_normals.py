"""fit_normals: the slow twin, and arguments that are right and wrong."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from reference.arguments import NEIGHBORS, POINTS, ROWS, changed
from torchjoint.ops import fit_normals

EXAMPLE: dict[str, Any] = {"points": POINTS, "neighbors": NEIGHBORS, "order": ROWS}
ERRORS = [
    ({"order": changed(ROWS, 2, 3)}, ValueError, "order: expected a permutation, got 2 again at 3"),
    ({"points": POINTS.long()}, TypeError, "points: expected dtype torch.float32 or torch.float64, got"),
    ({"points": POINTS[:, :2]}, ValueError, "points: expected shape [N, 3], got [4, 2]"),
    ({"points": POINTS[:3], "order": None}, ValueError, "neighbors: expected shape [N, K] = [3, K], got [4, 2]"),
    ({"neighbors": NEIGHBORS.short()}, TypeError, "expected dtype torch.int32 or torch.int64, got"),
    ({"neighbors": changed(NEIGHBORS, 4, 1, 0)}, ValueError, "numbers in [0, 4), got 4 in row 1"),
]
REFUSED = [{"points": POINTS.half()}, {"points": POINTS[:, :2]}, {"points": POINTS[:3]}]


def fit_normals_reference(points: Tensor, neighbors: Tensor, order: Tensor | None = None) -> Tensor:
    """What :func:`torchjoint.ops.fit_normals` computes; the arguments are not checked, and the order does not count.

    If a neighbourhood varies least in more than one direction, the result may be any of these directions.

    Example:
        >>> points = torch.tensor([[0.0, 0, 0], [0, 0, 1], [0, 2, 0]])
        >>> fit_normals_reference(points, torch.tensor([[1, 2], [0, 2], [0, 1]])).abs()
        tensor([[1., 0., 0.],
                [1., 0., 0.],
                [1., 0., 0.]])
    """
    if neighbors.shape[1] < 2:
        return torch.tensor([0.0, 0.0, 1.0]).repeat(points.shape[0], 1)
    points = points.double()
    around = points[neighbors.long()] - points[:, None]
    around = torch.cat([torch.zeros_like(around[:, :1]), around], dim=1)
    around = around - around.mean(dim=1, keepdim=True)
    _, vectors = torch.linalg.eigh(around.transpose(1, 2) @ around)
    x, y, z = vectors[:, :, 0].float().unbind(dim=1)
    sign = torch.where(z != 0, z, torch.where(y != 0, y, x))
    return torch.where(sign[:, None] < 0, -vectors[:, :, 0], vectors[:, :, 0]).float()


def long_call(share: float = 1) -> Callable[[], Any]:
    """A call that takes some tenths of a second, or about such a share of that."""
    generator = torch.Generator().manual_seed(0)
    points = torch.rand(int(500_000 * share), 3, generator=generator)
    neighbors = torch.randint(len(points), (len(points), 16), generator=generator)
    return lambda: fit_normals(points, neighbors)
