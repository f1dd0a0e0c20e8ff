"""Step 6, method learned: mean and quantiles of a measure of edges, over each boundary between two regions."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchjoint import ops

#: The quantiles of a summary; they follow the mean.
QUANTILES = (0.1, 0.5, 0.9)


class Measure(NamedTuple):
    """A measure of C edges. Its ranks are computed once, so that the quantiles of any groups need no floats sorted."""

    values: Tensor  #: [C] float32, NaN = missing
    rank: Tensor  #: [C] int64, place of each value in `ascending`
    ascending: Tensor  #: [C] float32, the values in ascending order, missing ones last

    @classmethod
    def of(cls, values: Tensor) -> Measure:
        """Ranks values [C] float32."""
        # NumPy's sort is several times as fast as torch's. Equal values may have any order: only values are read.
        order = torch.from_numpy(np.argsort(values.numpy()))
        rank = torch.empty_like(order)
        rank[order] = torch.arange(len(order))
        return cls(values, rank, values[order])


def summarize(measure: Measure, group: Tensor, num_groups: int) -> Tensor:
    """Mean and QUANTILES of the measure over the edges of each group; missing values do not count.

    Args:
        measure: of C edges.
        group: [C] int64, group of each edge, 0 ... G - 1, -1 = none.
        num_groups: G.

    Returns:
        [G, 1 + len(QUANTILES)] float64; NaN for a group without a value.
    """
    return ops.group_summaries(*measure, group, num_groups, torch.tensor(QUANTILES, dtype=torch.float32))


def sum_by(group: Tensor, values: Tensor, num_groups: int) -> Tensor:
    """Sums of values [n, ...] over groups [n] int64: [G, ...], added in the order of the values."""
    return values.new_zeros(num_groups, *values.shape[1:]).index_add_(0, group, values)
