"""Step 4: visibility by hidden point removal (Katz, Tal, Basri 2007)."""

from __future__ import annotations

import torch
from scipy.spatial import ConvexHull, QhullError
from torch import Tensor


def hidden_point_removal(points: Tensor, center: Tensor, radius_factor: float) -> Tensor:
    """Visibility of a point set by spherical flipping and a convex hull.

    S. Katz, A. Tal, R. Basri, "Direct Visibility of Point Sets", SIGGRAPH 2007. The sphere's radius is
    max |p - C| x N x `radius_factor`. A larger sphere keeps more points, hidden points among them. A denser cloud needs
    a larger sphere.

    Args:
        points: [N, 3] metres, world frame; none at the camera's position (the frustum's near plane guarantees this).
        center: [3] metres, C, the camera's position.
        radius_factor: see above.

    Returns:
        [N] bool, True for visible points.
    """
    visible = torch.zeros(points.shape[0], dtype=torch.bool)
    # Of duplicate points the hull has random ones: test one of them, and use its result for all.
    unique, inverse = torch.unique(points, dim=0, return_inverse=True)
    if unique.shape[0] < 5:  # too few for a hull; so few points hide nothing
        return ~visible
    seen_from = unique.double() - center
    distance = seen_from.norm(dim=1, keepdim=True)
    radius = float(distance.max()) * unique.shape[0] * radius_factor
    flipped = seen_from + 2 * (radius - distance) * seen_from / distance
    try:
        hull = ConvexHull(torch.cat([flipped, torch.zeros(1, 3, dtype=torch.float64)]).numpy(), qhull_options="Qt")
    except QhullError:  # all points lie in one plane through the camera, which is seen edge-on
        return ~visible
    on_hull = torch.zeros(unique.shape[0] + 1, dtype=torch.bool)  # the last one is the camera
    on_hull[torch.from_numpy(hull.vertices).long()] = True
    return on_hull[:-1][inverse]
