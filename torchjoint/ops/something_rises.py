"""Step 6, method scan: whether something rises from the points of a scan."""

from __future__ import annotations

import torch
from torch import Tensor

from torchjoint.ops._call import call
from torchjoint.ops._checks import check_array, check_number


def something_rises(
    column: Tensor,
    row: Tensor,
    height: Tensor,
    used: Tensor,
    which: Tensor,
    num_columns: int,
    num_rows: int,
    least: float,
    most: float,
) -> Tensor:
    """Whether a higher point lies in a point's cell of a grid, or in one of the 8 cells around it.

    The first and the last column are neighbours; the first and the last row are not.

    Args:
        column: ``[N]`` int64 in [0, ``num_columns``).
        row: ``[N]`` int64 in [0, ``num_rows``).
        height: ``[N]`` float64 metres, finite.
        used: ``[N]`` bool, the points that may be the higher ones.
        which: ``[M]`` int64, the points to test.
        num_columns: number of columns.
        num_rows: number of rows; the grid has less than 2^31 cells.
        least: metres; the higher point is more than this above the point,
        most: metres; and less than this.

    Returns:
        ``[M]`` bool. The number of threads does not change it.

    Raises:
        TypeError: an argument of the wrong type or dtype.
        ValueError: a wrong shape or value; the message names the argument.
    """
    check_array("column", column, torch.int64, (None,), "[N]")
    shape, name = (column.shape[0],), f"[N] = [{column.shape[0]}]"
    check_array("row", row, torch.int64, shape, name)
    check_array("height", height, torch.float64, shape, name)
    check_array("used", used, torch.bool, shape, name)
    check_array("which", which, torch.int64, (None,), "[M]")
    for name, number in (("num_columns", num_columns), ("num_rows", num_rows)):
        check_number(name, number, (int,))
    for name, metres in (("least", least), ("most", most)):
        check_number(name, metres, (int, float))
    grid = (column, row, height, used, which, num_columns, num_rows)
    found: Tensor = call(torch.ops.torchjoint.something_rises.default, *grid, least, most)
    return found


@torch.library.register_fake("torchjoint::something_rises")
def _fake(column: Tensor, row: Tensor, height: Tensor, used: Tensor, which: Tensor, *_: object) -> Tensor:
    return which.new_empty(which.shape, dtype=torch.bool)
