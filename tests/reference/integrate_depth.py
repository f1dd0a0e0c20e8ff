"""integrate_depth: the slow twin, and arguments that are right and wrong."""

from __future__ import annotations

import itertools
import math
from typing import Any

import torch
from torch import Tensor

from reference.arguments import EYE, changed

SUMS = torch.zeros(2, 512, 5, dtype=torch.int32)
BLOCK = torch.tensor([[0, 0, 1]])
EXAMPLE: dict[str, Any] = {
    "sums": SUMS, "row": torch.tensor([1]), "block": BLOCK, "depth": torch.full((3, 4), 1.2),
    "color": torch.arange(36, dtype=torch.uint8).view(3, 4, 3), "intrinsics": 4 * EYE[:3, :3],
    "world_to_camera": EYE, "voxel_size": 0.1, "truncation": 0.4, "far": 5.0,
}  # fmt: skip
ERRORS = [
    ({"sums": SUMS[:, :8]}, ValueError, "sums: expected length 512 in dimension 1, got 8"),
    ({"sums": SUMS.long()}, ValueError, "sums: expected another dtype"),
    ({"sums": SUMS.mT.contiguous().mT}, ValueError, "sums: expected a contiguous tensor"),
    ({"row": torch.tensor([2])}, ValueError, "row: expected numbers in [0, 2), got 2 at 0"),
    ({"row": torch.tensor([1, 1]), "block": BLOCK.repeat(2, 1)}, ValueError, "row: expected ascending numbers, got 1"),
    ({"block": BLOCK.int()}, ValueError, "block: expected another dtype"),
    ({"block": changed(BLOCK, 2**40, 0, 0)}, ValueError, "block: expected numbers of 32 bits, got 1099511627776"),
    ({"depth": torch.zeros(3)}, ValueError, "depth: expected 2 dimensions"),
    ({"color": torch.zeros(3, 4, 4, dtype=torch.uint8)}, ValueError, "color: expected length 3 in dimension 2, got 4"),
    ({"intrinsics": EYE}, ValueError, "intrinsics: expected length 3 in dimension 0, got 4"),
    ({"world_to_camera": EYE.float()}, ValueError, "world_to_camera: expected another dtype"),
    ({"voxel_size": 0.0}, ValueError, "voxel_size: expected a number > 0, got 0"),
    ({"truncation": 0.0}, ValueError, "truncation: expected a number > 0, got 0"),
    ({"far": -1.0}, ValueError, "far: expected a number >= 0, got -1.0"),
]
REFUSED = [{"sums": SUMS.long()}, {"row": torch.tensor([2])}, {"color": torch.zeros(3, 4, 3)}, {"depth": EYE}]


def integrate_depth_reference(
    sums: Tensor,
    row: Tensor,
    block: Tensor,
    depth: Tensor,
    color: Tensor,
    intrinsics: Tensor,
    world_to_camera: Tensor,
    voxel_size: float,
    truncation: float,
    far: float,
) -> None:
    """What :func:`torchjoint.ops.internal.integrate_depth` does; the arguments are not checked."""
    (fx, _, cx), (_, fy, cy), _ = intrinsics.tolist()
    pose = world_to_camera.tolist()
    for to, corner in zip(row.tolist(), block.tolist(), strict=True):
        for number, inside in enumerate(itertools.product(range(8), repeat=3)):
            place = [(8 * c + i + 0.5) * voxel_size for c, i in zip(corner, inside, strict=True)]
            x, y, z = (((r[0] * place[0] + r[1] * place[1]) + r[2] * place[2]) + r[3] for r in pose[:3])
            if not z > 0:
                continue
            x, y = x / z, y / z
            column, line = fx * x + cx + 0.5, fy * y + cy + 0.5
            if not (0 <= line < depth.shape[0] and 0 <= column < depth.shape[1]):
                continue
            line, column = int(line), int(column)
            measured = float(depth[line, column])
            distance = (measured - z) * math.sqrt(1 + (x * x + y * y))
            if not 0 < measured <= far or not distance > -truncation or sums[to, number, 1] >= 2**16:
                continue
            sums[to, number, 0] += math.floor(min(1.0, distance / truncation) * 2**14 + 0.5)
            sums[to, number, 1] += 1
            sums[to, number, 2:] += color[line, column]
