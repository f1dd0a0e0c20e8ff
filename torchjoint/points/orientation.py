"""Step 3: the signs of normals. A surface is seen from outside, so its normals point to the cameras that see it."""

from __future__ import annotations

import torch
from torch import Tensor

from torchjoint.points._vectors import dot
from torchjoint.points.graph import PointGraph
from torchjoint.scene.camera import camera_center


def faces_camera(graph: PointGraph, point: Tensor, world_to_camera: Tensor) -> Tensor:
    """[M] int64, for each of the points [M]: 1 where its normal shows to the camera's side, -1 where away from it."""
    towards_camera = camera_center(world_to_camera).float() - graph.points[point]
    return dot(graph.normals[point], towards_camera).sign().long()


def orient_normals(graph: PointGraph, facing: Tensor) -> tuple[Tensor, Tensor]:
    """Turns normals to the cameras: a surface is seen from outside.

    Args:
        facing: [N] sum of :func:`faces_camera` over the images that see a point.

    Returns:
        normals [N, 3], and whether each one's sign is known, [N] bool.
    """
    if graph.normals_are_given:  # the cameras know better than a file, but a file better than nobody
        facing = torch.where(facing == 0, 1, facing)
    return torch.where(facing[:, None] < 0, -graph.normals, graph.normals), facing != 0
