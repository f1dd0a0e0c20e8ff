"""Step 6, method learned: sorts the values of a measure, as quantiles over many groups need it."""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor

from torchjoint.ops._call import call
from torchjoint.ops._checks import check_array


def ascending_order(values: Tensor) -> Tensor:
    """Compute the order of values, like a stable sort: equal values keep their order, -0 equals 0, NaN comes last.

    The running time is linear.

    Args:
        values: ``[C]`` float32.

    Returns:
        ``[C]`` int32, the places of the values in ascending order.

    Raises:
        TypeError: an argument of the wrong type or dtype.
        ValueError: a wrong shape or device.

    Example:
        >>> import torch
        >>> ascending_order(torch.tensor([3.0, -1.0, torch.nan, 3.0, 0.5]))
        tensor([1, 4, 0, 3, 2], dtype=torch.int32)
    """
    check_array("values", values, torch.float32, (None,), "[C]")
    return cast(Tensor, call(torch.ops.torchjoint.ascending_order.default, values))


@torch.library.register_fake("torchjoint::ascending_order")
def _fake(values: Tensor) -> Tensor:
    return values.new_empty(values.shape[0], dtype=torch.int32)
