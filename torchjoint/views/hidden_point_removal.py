"""Step 4: visibility by hidden point removal (Katz, Tal, Basri 2007)."""

from __future__ import annotations

import torch
from torch import Tensor


def hidden_point_removal(points: Tensor, center: Tensor, radius_factor: float) -> Tensor:
    """Visibility of a point set by spherical flipping and a convex hull (Katz, Tal, Basri 2007).

    The sphere's radius is max |p - C| x N x `radius_factor`: a larger sphere keeps more points, hidden ones among
    them, and the denser the cloud the larger it must be.

    Args:
        points: [N, 3] world frame; none at the camera itself (the frustum's near plane sees to that).
        center: [3] the camera's.

    Returns:
        [N] bool.
    """
    visible = torch.zeros(points.shape[0], dtype=torch.bool)
    # Copies of a point would all be on the hull or none, at random: keep the first, let the others follow it.
    unique, inverse = torch.unique(points, dim=0, return_inverse=True)
    if unique.shape[0] < 5:  # no hull of the flipped points and the centre: nothing hides so few
        return ~visible
    from open3d import geometry, utility

    cloud = geometry.PointCloud(utility.Vector3dVector(unique.double().numpy()))
    distance = (unique.double() - center).norm(dim=1)
    try:
        _, kept = cloud.hidden_point_removal(center.numpy(), float(distance.max()) * unique.shape[0] * radius_factor)
    except RuntimeError:  # qhull: all points in one plane through the camera, seen edge-on
        return ~visible
    visible_unique = torch.zeros(unique.shape[0], dtype=torch.bool)
    visible_unique[torch.tensor(kept, dtype=torch.int64)] = True
    return visible_unique[inverse]
