"""Step 6, method scan: the distances of points to their nearest neighbours, where they are neither small nor large."""

from __future__ import annotations

import torch
from torch import Tensor

from torchjoint.ops._call import call
from torchjoint.ops._checks import check_array, check_number


def local_spacing(points: Tensor, reach: Tensor, share: float, count: int) -> Tensor:
    """Measure the mean distance of each point to its nearest neighbours, if it is between a share of its reach and it.

    This takes a fraction of the time of a search for all neighbours.

    Args:
        points: ``[N, 3]`` float32 metres, finite.
        reach: ``[N]`` float64 metres, finite, not negative.
        share: in [0, 1].
        count: number of nearest neighbours, 1 to 8.

    Returns:
        ``[N]`` float64 metres: 0 if the mean distance is at most ``share * reach``, infinite if it is more than
        ``reach`` or if there are too few points. The number of threads does not change it.

    Raises:
        TypeError: an argument of the wrong type or dtype.
        ValueError: a wrong shape or value; the message names the argument.

    Example:
        >>> points, reach = torch.tensor([[0.0, 0, 0], [1, 0, 0], [3, 0, 0]]), torch.tensor([2.0, 1, 1]).double()
        >>> local_spacing(points, reach, share=0.5, count=1).tolist()
        [0.0, 1.0, inf]
    """
    check_array("points", points, torch.float32, (None, 3), "[N, 3]")
    check_array("reach", reach, torch.float64, (points.shape[0],), f"[N] = [{points.shape[0]}]")
    check_number("share", share, (int, float))
    check_number("count", count, (int,))
    found: Tensor = call(torch.ops.torchjoint.local_spacing.default, points, reach, share, count)
    return found


@torch.library.register_fake("torchjoint::local_spacing")
def _fake(points: Tensor, reach: Tensor, share: float, count: int) -> Tensor:
    return torch.empty_like(reach)
