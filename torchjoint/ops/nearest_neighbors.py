"""Step 3: the nearest neighbours of the points of a cloud."""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor

from torchjoint.ops._call import call
from torchjoint.ops._checks import FLOATING, check_array, check_number, check_tensor


def nearest_neighbors(
    points: Tensor, count: int, num_distances: int | None = None, limits: Tensor | None = None
) -> tuple[Tensor, Tensor]:
    """Find the nearest neighbours of each point, nearest first, without the point itself.

    Exact: squared distances are computed and compared in float64, as ``(x² + y²) + z²``. Of equally far points the one
    with the smaller number comes first. Copies of a point are its neighbours, at distance 0. Coordinates in float64
    between -1e-136 and 1e-136 count as 0, because their squares vanish.

    Args:
        points: ``[N, 3]`` float32 or float64, finite, N < 2^31.
        count: K >= 0; if there are fewer other points, K is their number.
        num_distances: D >= 0, the number of nearest neighbours whose distances are returned; default and maximum: K.
        limits: ``[N]`` float64, not negative, the largest distance of each point's neighbours. If there are fewer than
            K, the point itself takes the place of the others, at an infinite distance. None: no limits.

    Returns:
        ``[N, K]`` int32 numbers of the neighbours, and ``[N, D]`` their distances, in the dtype of the points. Runs on
        torch's threads; the result does not depend on the number of threads. No gradient flows through it.

    Raises:
        TypeError: an argument of the wrong type or dtype.
        ValueError: a wrong shape or device, a negative number, a coordinate that is not finite.

    Example:
        >>> import torch
        >>> points = torch.tensor([[0.0, 0, 0], [1, 0, 0], [3, 0, 0], [-1, 0, 0]])
        >>> indices, distances = nearest_neighbors(points, 2)
        >>> indices.tolist()
        [[1, 3], [0, 2], [1, 0], [0, 1]]
        >>> distances.tolist()
        [[1.0, 1.0], [1.0, 2.0], [2.0, 3.0], [1.0, 2.0]]
    """
    check_tensor("points", points, FLOATING)
    if points.dim() != 2 or points.shape[1] != 3:
        raise ValueError(f"points: expected shape [N, 3], got {list(points.shape)}")
    check_number("count", count, (int,))
    if num_distances is None:
        num_distances = count
    check_number("num_distances", num_distances, (int,))
    if limits is not None:
        check_array("limits", limits, torch.float64, (len(points),), f"[N] = [{len(points)}]")
    found = call(torch.ops.torchjoint.nearest_neighbors.default, points, count, num_distances, limits)
    return cast(tuple[Tensor, Tensor], found)


@torch.library.register_fake("torchjoint::nearest_neighbors")
def _fake(points: Tensor, count: int, num_distances: int, limits: Tensor | None) -> tuple[Tensor, Tensor]:
    num_points = points.shape[0]
    count = min(count, max(num_points - 1, 0))
    indices = points.new_empty((num_points, count), dtype=torch.int32)
    return indices, points.new_empty((num_points, min(num_distances, count)))
