"""Step 6, method scan: the height of the ground at the points of a scan."""

from __future__ import annotations

import torch
from torch import Tensor

from torchjoint.ops._call import call
from torchjoint.ops._checks import check_array, check_number


def ground_heights(
    azimuth: Tensor,
    elevation: Tensor,
    distance: Tensor,
    height: Tensor,
    used: Tensor,
    num_columns: int,
    row_height: float,
    slope: float,
    step: float,
    bump: float,
    near: float,
    blind: float,
    sides: int,
) -> Tensor:
    """Follow the ground of a scan outward, in each column of azimuth, over the lowest points of its cells.

    A profile starts below the sensor, at the (lower) median of the columns' lowest points within ``near``. It goes on
    to the lowest point of the next cell of elevation, if this point is farther out than the profile so far, and than
    the blind distance, and if the height changes by at most ``step + slope * way``. The blind distance is the share
    ``blind`` of that at which the lowest beam (0.5 % quantile of elevations) meets level ground. Places more than
    ``bump`` above the median of the profiles of ``sides`` columns on each side are removed, then heights are
    interpolated linearly, along the profiles and between the middles of columns.

    Args:
        azimuth: ``[N]`` float64 radians in [-pi, pi].
        elevation: ``[N]`` float64 radians in [-pi/2, pi/2].
        distance: ``[N]`` float64 metres, horizontal, finite.
        height: ``[N]`` float64 metres above the sensor, finite.
        used: ``[N]`` bool, the points that may be ground, at least one.
        num_columns: number of columns of the whole turn.
        row_height: of the cells, radians.
        slope: metres per metre.
        step: metres.
        bump: metres.
        near: metres; if no point is so near, it is the distance of the nearest.
        blind: share.
        sides: number of columns.

    Returns:
        ``[N]`` float64 metres above the sensor, the ground at each point. The number of threads does not change it.

    Raises:
        TypeError: an argument of the wrong type or dtype.
        ValueError: a wrong shape or value; the message names the argument.
    """
    check_array("azimuth", azimuth, torch.float64, (None,), "[N]")
    shape = (azimuth.shape[0],)
    for name, values in (("elevation", elevation), ("distance", distance), ("height", height)):
        check_array(name, values, torch.float64, shape, f"[N] = [{shape[0]}]")
    check_array("used", used, torch.bool, shape, f"[N] = [{shape[0]}]")
    numbers = {"row_height": row_height, "slope": slope, "step": step, "bump": bump, "near": near, "blind": blind}
    for name, number in numbers.items():
        check_number(name, number, (int, float))
    for name, number in (("num_columns", num_columns), ("sides", sides)):
        check_number(name, number, (int,))
    seen = (azimuth, elevation, distance, height, used)
    found: Tensor = call(torch.ops.torchjoint.ground_heights.default, *seen, num_columns, *numbers.values(), sides)
    return found


@torch.library.register_fake("torchjoint::ground_heights")
def _fake(azimuth: Tensor, *_: object) -> Tensor:
    return torch.empty_like(azimuth)
