"""Step 3: orients normals. A surface is seen from outside, so its normals point to the cameras that see it."""

from __future__ import annotations

import torch
from torch import Tensor

from torchjoint.cloud._vectors import dot
from torchjoint.cloud.graph import PointGraph
from torchjoint.scene.camera import camera_center


def orientation_votes(graph: PointGraph, point: Tensor, world_to_camera: Tensor) -> Tensor:
    """The direction of normals relative to a camera: [M] int64, 1 = towards it, -1 = away from it, 0 = neither.

    Args:
        graph: points and normals.
        point: [M] int64, the points that the camera sees.
        world_to_camera: [4, 4].
    """
    towards_camera = camera_center(world_to_camera).float() - graph.points[point]
    return dot(graph.normals[point], towards_camera).sign().long()


def orient_normals(graph: PointGraph, facing: Tensor) -> tuple[Tensor, Tensor]:
    """Turns normals to the cameras, because a surface is seen from outside.

    Args:
        graph: the graph with the normals.
        facing: [N] int64, sum of :func:`orientation_votes` over the images that see a point.

    Returns:
        normals [N, 3], and whether each normal is oriented, [N] bool.
    """
    if graph.has_given_normals:  # cameras are more reliable than a file, but without cameras trust the file
        facing = torch.where(facing == 0, 1, facing)
    return torch.where(facing[:, None] < 0, -graph.normals, graph.normals), facing != 0
