"""region_planes: the slow twin, and arguments that are right and wrong."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from reference.arguments import EYE, NEIGHBORS, PIXELS, POINTS, SOURCE, changed
from torchjoint.ops.internal import region_planes

EXAMPLE: dict[str, Any] = {
    "points": POINTS, "neighbors": NEIGHBORS, "region": torch.tensor([0, 0, 0, 1]), "normals": POINTS + 1,
    "min_points": 3,
}  # fmt: skip
ERRORS = [
    ({"points": EYE[:, :3]}, ValueError, "points: expected another dtype"),
    ({"points": POINTS[:, :2]}, ValueError, "points: expected length 3 in dimension 1, got 2"),
    ({"neighbors": NEIGHBORS.short()}, ValueError, "neighbors: expected dtype torch.int32 or torch.int64"),
    ({"neighbors": NEIGHBORS[:3]}, ValueError, "neighbors: expected shape [4, K]"),
    ({"neighbors": changed(NEIGHBORS, 4, 1, 0)}, ValueError, "numbers in [0, 4), got 4 in row 1"),
    ({"neighbors": changed(NEIGHBORS, -1, 3, 0).int()}, ValueError, "in [0, 4), got -1 in row 3"),
    ({"region": PIXELS}, ValueError, "region: expected length 4 in dimension 0, got 3"),
    ({"region": SOURCE}, ValueError, "region: expected another dtype"),
    ({"normals": POINTS[:3]}, ValueError, "normals: expected length 4 in dimension 0, got 3"),
    ({"min_points": 2}, ValueError, "min_points: expected at least 3, got 2"),
    ({"min_points": -3}, ValueError, "min_points: expected at least 3, got -3"),
    ({"min_points": 3.0}, RuntimeError, "Expected a value of type 'int' for argument 'min_points'"),
]
REFUSED = [
    {"points": POINTS[:, :2]},
    {"neighbors": NEIGHBORS[:3]},
    {"neighbors": NEIGHBORS.float()},
    {"region": PIXELS},
    {"normals": EYE[:, :3]},
    {"min_points": 2},
]


def region_planes_reference(
    points: Tensor, neighbors: Tensor, region: Tensor, normals: Tensor, min_points: int = 6
) -> tuple[Tensor, Tensor]:
    """What :func:`torchjoint.ops.internal.region_planes` computes; the arguments are not checked.

    If a neighbourhood varies least in more than one direction, the result may be any of these directions.

    Example:
        >>> points = torch.tensor([[0.0, 0, 0], [0, 1, 0], [0, 0, 1]])
        >>> neighbors, up = torch.tensor([[1, 2], [0, 2], [0, 1]]), torch.tensor([[-1.0, 0, 1]]).expand(3, 3)
        >>> region_planes_reference(points, neighbors, torch.zeros(3).long(), up, 3)[1][0] + 0.0
        tensor([-1.,  0.,  0.])
    """
    means, fitted = points.clone(), normals.clone()
    for i, row in enumerate(neighbors.long()):
        own = torch.cat([torch.tensor([i]), row[region[row] == region[i]]])
        around = points[own].double()
        means[i] = around.mean(dim=0).float()
        if len(own) >= min_points:
            centred = around - around.mean(dim=0)
            normal = torch.linalg.eigh(centred.t() @ centred)[1][:, 0]
            fitted[i] = (normal if normal @ normals[i].double() >= 0 else -normal).float()
    return means, fitted


def long_call(share: float = 1) -> Callable[[], Any]:
    """A call that takes some tenths of a second, or about such a share of that."""
    generator = torch.Generator().manual_seed(0)
    points = torch.rand(int(500_000 * share), 3, generator=generator)
    neighbors = torch.randint(len(points), (len(points), 16), generator=generator)
    region = torch.arange(len(points)) % 2
    return lambda: region_planes(points, neighbors, region, points)
