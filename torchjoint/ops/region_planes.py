"""Step 6, method learned: fits a plane to each point and its neighbours in the same region."""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor

from torchjoint.ops._call import call
from torchjoint.ops._checks import check_array, check_neighbors, check_number


def region_planes(
    points: Tensor, neighbors: Tensor, region: Tensor, normals: Tensor, min_points: int = 6
) -> tuple[Tensor, Tensor]:
    """Fit a plane to each point and its neighbours in the same region.

    Sums are computed in float64, relative to the point.

    Args:
        points: ``[N, 3]`` float32, finite.
        neighbors: ``[N, K]`` int32 or int64, N < 2^31: the neighbours of each point, without the point itself.
        region: ``[N]`` int64, region of each point.
        normals: ``[N, 3]`` float32. A fitted normal gets the sign with which it points to the side of this normal. If
            too few of the points are in the region, this normal is returned.
        min_points: smallest number of points, including the point itself, to which a plane is fitted; >= 3.

    Returns:
        ``[N, 3]`` float32, the mean of the points in the region; ``[N, 3]`` float32, the normal, of unit length if it
        is fitted. Runs on torch's threads; the result does not depend on the number of threads. No gradient flows
        through it.

    Raises:
        TypeError: an argument of the wrong type or dtype.
        ValueError: a wrong shape or device, a neighbour outside [0, N), ``min_points`` below 3.

    Example:
        >>> import torch
        >>> points = torch.tensor([[0.0, 0, 0], [0, 1, 0], [0, 0, 1], [5, 0, 0]])
        >>> neighbors = torch.tensor([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])
        >>> up = torch.tensor([[1.0, 1, 1]]).expand(4, 3)
        >>> mean, normal = region_planes(points, neighbors, torch.tensor([0, 0, 0, 1]), up, min_points=3)
        >>> mean[0], normal[0] + 0.0, normal[3]
        (tensor([0.0000, 0.3333, 0.3333]), tensor([1., 0., 0.]), tensor([1., 1., 1.]))
    """
    check_array("points", points, torch.float32, (None, 3), "[N, 3]")
    num_points = points.shape[0]
    check_neighbors(neighbors, num_points)
    check_array("region", region, torch.int64, (num_points,), f"[N] = [{num_points}]")
    check_array("normals", normals, torch.float32, (num_points, 3), f"[N, 3] = [{num_points}, 3]")
    check_number("min_points", min_points, (int,))
    return cast(
        "tuple[Tensor, Tensor]",
        call(torch.ops.torchjoint.region_planes.default, points, neighbors, region, normals, min_points),
    )


@torch.library.register_fake("torchjoint::region_planes")
def _fake(points: Tensor, neighbors: Tensor, region: Tensor, normals: Tensor, min_points: int) -> tuple[Tensor, Tensor]:
    return points.new_empty(points.shape), points.new_empty(points.shape)
