"""project: the slow twin, and arguments that are right and wrong."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from reference.arguments import EYE, NAN, POSITIONS

EXAMPLE: dict[str, Any] = {
    "points": torch.tensor([[0.0, 0.0, 2.0], [1.0, 0.0, 1.0], [0.0, 0.0, -1.0]]), "camera_from_world": EYE,
    "intrinsics": EYE[:3, :3] * 4, "near": 0.1, "far": 9.0, "height": 4, "width": 6, "margin": 1.0,
}  # fmt: skip
ERRORS = [
    ({"points": [[0, 0, 1]]}, TypeError, "points: expected a torch.Tensor, got list"),
    ({"points": EYE}, TypeError, "points: expected dtype torch.float32, got torch.float64"),
    ({"points": POSITIONS}, ValueError, "points: expected shape [N, 3], got [3]"),
    ({"camera_from_world": EYE[:3]}, ValueError, "camera_from_world: expected shape [4, 4], got [3, 4]"),
    ({"intrinsics": EYE.float()}, TypeError, "intrinsics: expected dtype torch.float64, got torch.float32"),
    ({"near": 0.0}, ValueError, "near: expected a number > 0, got 0"),
    ({"far": NAN}, ValueError, "far: expected a number >= 0, got nan"),
    ({"height": 4.5}, TypeError, "height: expected int, got float"),
    ({"width": -1}, ValueError, "width: expected a number >= 0, got -1"),
    ({"margin": -1}, ValueError, "margin: expected a number >= 0, got -1"),
]
REFUSED = [
    {"points": EYE},
    {"points": POSITIONS},
    {"camera_from_world": EYE[:3]},
    {"intrinsics": EYE},
    {"width": 2**40},
    {"margin": NAN},
]


def project_reference(
    points: Tensor,
    camera_from_world: Tensor,
    intrinsics: Tensor,
    near: float,
    far: float,
    height: int,
    width: int,
    margin: float = 0.0,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """What :func:`torchjoint.ops.project` computes; the arguments are not checked."""
    x, y, z = (
        ((row[0] * points[:, 0].double() + row[1] * points[:, 1].double()) + row[2] * points[:, 2].double()) + row[3]
        for row in camera_from_world[:3]
    )
    u = (intrinsics[0, 0] * x / z + intrinsics[0, 2]).float()
    v = (intrinsics[1, 1] * y / z + intrinsics[1, 2]).float()
    column, row = (u + 0.5).floor().double(), (v + 0.5).floor().double()
    inside = (column >= -margin) & (column < width + margin) & (row >= -margin) & (row < height + margin)
    point = torch.nonzero((z > near) & (z < far) & inside).squeeze(1)
    return point, u[point], v[point], z[point].float()
