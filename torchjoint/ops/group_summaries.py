"""Step 6, method learned: mean and quantiles of a measure over each of many groups."""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor

from torchjoint.ops._call import call
from torchjoint.ops._checks import check_array, check_number


def group_summaries(values: Tensor, order: Tensor, group: Tensor, num_groups: int, quantiles: Tensor) -> Tensor:
    """Compute the mean and quantiles of the finite values in each group.

    The caller sorts the values once for many groupings. Then the running time of each grouping is linear. The quantile
    q of n values is the value at index (n - 1) q in ascending order; the index is computed in float32 and rounded to
    the nearest integer, ties to even.

    Args:
        values: ``[C]`` float32.
        order: ``[C]`` int32, a permutation: the indices of the values, those of each group in ascending order; indices
            of values that are not finite may be anywhere. See :func:`ascending_order`.
        group: ``[C]`` int64, the group of each value, 0 ... G - 1, or -1 = none.
        num_groups: G.
        quantiles: ``[Q]`` float32 in [0, 1].

    Returns:
        ``[G, 1 + Q]`` float64: the mean, summed in the order of the values, and the quantiles; NaN for a group without
        a finite value. No gradient flows through it.

    Raises:
        TypeError: an argument of the wrong type or dtype.
        ValueError: a wrong shape or device; an index, group or quantile out of range; an order that is no permutation
            or not ascending.

    Example:
        >>> import torch
        >>> from torchjoint.ops.ascending_order import ascending_order
        >>> values, group = torch.tensor([5.0, 1.0, 3.0, 7.0]), torch.tensor([0, 0, 0, 1])
        >>> group_summaries(values, ascending_order(values), group, 2, torch.tensor([0.5, 1.0]))
        tensor([[3., 3., 5.],
                [7., 7., 7.]], dtype=torch.float64)
    """
    check_array("values", values, torch.float32, (None,), "[C]")
    count = values.shape[0]
    for name, value, dtype in (
        ("order", order, torch.int32),
        ("group", group, torch.int64),
    ):
        check_array(name, value, dtype, (count,), f"[C] = [{count}]")
    check_number("num_groups", num_groups, (int,))
    check_array("quantiles", quantiles, torch.float32, (None,), "[Q]")
    result = call(
        torch.ops.torchjoint.group_summaries.default,
        values,
        order,
        group,
        num_groups,
        quantiles,
    )
    return cast(Tensor, result)


@torch.library.register_fake("torchjoint::group_summaries")
def _fake(values: Tensor, order: Tensor, group: Tensor, num_groups: int, quantiles: Tensor) -> Tensor:
    return values.new_empty(num_groups, 1 + quantiles.shape[0], dtype=torch.float64)
