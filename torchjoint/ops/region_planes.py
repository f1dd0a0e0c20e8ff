"""Planes fitted to those neighbours of a point that lie in its own region."""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor

from torchjoint.ops._checks import check_array, check_neighbors, check_number


def region_planes(
    points: Tensor, neighbors: Tensor, region: Tensor, normals: Tensor, min_points: int = 6
) -> tuple[Tensor, Tensor]:
    """Fit a plane to each point and those of its neighbours that are in the same region.

    Sums are taken in float64, relative to the point.

    Args:
        points: ``[N, 3]`` float32, finite.
        neighbors: ``[N, K]`` int32 or int64, N < 2^31: the neighbours of each point, itself left out.
        region: ``[N]`` int64.
        normals: ``[N, 3]`` float32, to whose side the planes' normals are turned, and which are kept where there are
            too few points.
        min_points: a plane is fitted to at least so many, the point itself among them; >= 3.

    Returns:
        ``[N, 3]`` float32, the mean of the points that count; ``[N, 3]`` float32, the normal, unit length where it is
        fitted. Runs on torch's threads; the result does not depend on how many there are. No gradient flows through it.

    Raises:
        TypeError: an argument of the wrong type or dtype.
        ValueError: a wrong shape or device, a number outside [0, N), less than 3 points.

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
        torch.ops.torchjoint.region_planes.default(points.detach(), neighbors, region, normals.detach(), min_points),
    )


@torch.library.register_fake("torchjoint::region_planes")
def _fake(points: Tensor, neighbors: Tensor, region: Tensor, normals: Tensor, min_points: int) -> tuple[Tensor, Tensor]:
    return points.new_empty(points.shape), points.new_empty(points.shape)
