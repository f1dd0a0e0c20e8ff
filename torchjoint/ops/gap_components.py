"""Step 6, method scan: which points are connected over gaps."""

from __future__ import annotations

import torch
from torch import Tensor

from torchjoint.ops._call import call
from torchjoint.ops._checks import check_array, check_neighbors, check_number


def gap_components(
    points: Tensor, gap: Tensor, neighbors: Tensor, used: Tensor, min_size: int = 0, joining: float = 1.0
) -> Tensor:
    """Find the connected components of points, each of which allows a gap of its own.

    Neighbours are connected if their distance is at most the smaller one of their gaps. Then small components join
    others: neighbours at a distance of at most ``joining`` such gaps are visited in the order of distance per gap (of
    equal ones: by the numbers of the points), and if a component of either has fewer than ``min_size`` points, both
    become one.

    Args:
        points: ``[N, 3]`` float32 metres.
        gap: ``[N]`` float64 metres, not negative.
        neighbors: ``[N, K]`` int32 or int64, neighbours of each point.
        used: ``[N]`` bool; other points are connected to nothing.
        min_size: smallest number of points of a component that joins no other.
        joining: largest distance at which small components join others, in gaps; at least 1.

    Returns:
        ``[N]`` int64 labels 0, 1, ... in the order of their first points. The number of threads does not change them.

    Raises:
        TypeError: an argument of the wrong type or dtype.
        ValueError: a wrong shape or value; the message names the argument.
    """
    check_array("points", points, torch.float32, (None, 3), "[N, 3]")
    shape, name = (points.shape[0],), f"[N] = [{points.shape[0]}]"
    check_array("gap", gap, torch.float64, shape, name)
    check_neighbors(neighbors, points.shape[0])
    check_array("used", used, torch.bool, shape, name)
    check_number("min_size", min_size, (int,))
    check_number("joining", joining, (int, float))
    arguments = (points, gap, neighbors, used, min_size, joining)
    labels: Tensor = call(torch.ops.torchjoint.gap_components.default, *arguments)
    return labels


@torch.library.register_fake("torchjoint::gap_components")
def _fake(points: Tensor, *_: object) -> Tensor:
    return points.new_empty(points.shape[0], dtype=torch.int64)
