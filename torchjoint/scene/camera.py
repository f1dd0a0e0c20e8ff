"""The position of a camera, used by step 3 (orientation of normals) and step 4 (visibility)."""

from __future__ import annotations

from torch import Tensor


def camera_center(world_to_camera: Tensor) -> Tensor:
    """The camera's position in the world frame, -R^T t: [4, 4] rigid -> [3] metres, of the same dtype."""
    return -(world_to_camera[:3, :3].T @ world_to_camera[:3, 3])
