"""Step 3: normals of planes fitted to the neighbourhoods of points."""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor

from torchjoint.ops._call import call
from torchjoint.ops._checks import FLOATING, check_neighbors, check_order, check_tensor


def fit_normals(points: Tensor, neighbors: Tensor, order: Tensor | None = None) -> Tensor:
    """Fit a plane to each point and its neighbours, and return its normal.

    The normal is the eigenvector for the smallest eigenvalue of the points' covariance. Covariances are computed in
    float64, relative to the point. Of a plane's two normals, the upper one is returned: z > 0, or z = 0 and y > 0, or
    z = y = 0 and x > 0. The normal is (0, 0, 1) if the points coincide, vary equally in all directions, or are fewer
    than three (K < 2). If the points lie on a line, the normal is perpendicular to the line.

    Args:
        points: ``[N, 3]`` float32 or float64, finite.
        neighbors: ``[N, K]`` int32 or int64, N < 2^31: the neighbours of each point, without the point itself.
        order: ``[N]`` int32, a permutation: the order in which rows are processed; the result does not depend on it.
            For a large cloud in random order, a spatial one (:func:`ascending_order` of its cells) is much faster.
            Default: 0, 1, ...

    Returns:
        ``[N, 3]`` float32, unit length. Runs on torch's threads; the result does not depend on the number of threads.
        No gradient flows through it.

    Raises:
        TypeError: an argument of the wrong type or dtype.
        ValueError: a wrong shape or device, a neighbour outside [0, N), an order that is no permutation.

    Example:
        >>> import torch
        >>> points = torch.tensor([[0.0, 0, 0], [0, 0, 1], [0, 2, 0]])  # in the plane x = 0
        >>> fit_normals(points, torch.tensor([[1, 2], [0, 2], [0, 1]])).abs()
        tensor([[1., 0., 0.],
                [1., 0., 0.],
                [1., 0., 0.]])
    """
    check_tensor("points", points, FLOATING)
    if points.dim() != 2 or points.shape[1] != 3:
        raise ValueError(f"points: expected shape [N, 3], got {list(points.shape)}")
    check_neighbors(neighbors, points.shape[0])
    check_order(order, points.shape[0])
    return cast(Tensor, call(torch.ops.torchjoint.fit_normals.default, points, neighbors, order))


@torch.library.register_fake("torchjoint::fit_normals")
def _fake(points: Tensor, neighbors: Tensor, order: Tensor | None = None) -> Tensor:
    return points.new_empty((points.shape[0], 3), dtype=torch.float32)
