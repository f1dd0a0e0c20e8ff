"""Step 6, method learned: mean and quantiles of a measure of edges, over each boundary between two regions."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate
from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint.ops.internal import ascending_order, group_summaries

#: The quantiles of a summary; they follow the mean.
QUANTILES = (0.1, 0.5, 0.9)


class Measure(NamedTuple):
    """A measure of C edges. It is sorted once, so that quantiles of groups of edges need no further sort."""

    values: Tensor  #: [C] float32, NaN = missing
    order: Tensor  #: [C] int32, places of the values; in ascending order, if the edges are of one graph

    @classmethod
    def of(cls, values: Tensor) -> Measure:
        """Sorts values [C] float32."""
        return cls(values, ascending_order(values))

    @classmethod
    def union(cls, measures: Sequence[Measure]) -> Measure:
        """The measures of several graphs, one after the other. No group may have edges of two graphs."""
        *starts, _ = accumulate((len(one.values) for one in measures), initial=0)
        orders = [one.order + start for one, start in zip(measures, starts, strict=True)]
        return cls(torch.cat([one.values for one in measures]), torch.cat(orders))


def summarize(measure: Measure, group: Tensor, num_groups: int) -> Tensor:
    """Mean and QUANTILES of the measure over the edges of each group; missing values do not count.

    Args:
        measure: of C edges.
        group: [C] int64, group of each edge, 0 ... G - 1, -1 = none.
        num_groups: G.

    Returns:
        [G, 1 + len(QUANTILES)] float64; NaN for a group without a value.
    """
    return group_summaries(*measure, group, num_groups, torch.tensor(QUANTILES, dtype=torch.float32))


def sum_by(group: Tensor, values: Tensor, num_groups: int) -> Tensor:
    """Sums of values [n, ...] over groups [n] int64: [G, ...], added in the order of the values."""
    return values.new_zeros(num_groups, *values.shape[1:]).index_add_(0, group, values)
