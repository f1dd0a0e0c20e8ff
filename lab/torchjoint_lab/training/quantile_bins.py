"""Weighted quantile bins of the columns of a table, for trees that split between bins.

scikit-learn (1.9) makes such bins itself, but sorts each column again for each of 255 quantiles of weighted rows, which
takes far longer than to grow the trees. So the trees are grown on the numbers of our bins, of which there are few
enough that scikit-learn keeps them as they are; afterwards the thresholds are taken back to values.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: Largest number of bins of a column; scikit-learn's own limit, too.
MAX_BINS = 255


class QuantileBins:
    """Bins of about equal weight for each column; bin b of a column ends at its edge b, which belongs to it.

    Args:
        values: [R, F] float, NaN = missing.
        weight: [R] float, >= 0.
    """

    def __init__(self, values: NDArray[np.float32], weight: NDArray[np.float64]) -> None:
        counts = weight > 0
        self._edges = [_edges(column[counts], weight[counts]) for column in values.T]

    def numbers(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """The number of the bin of each value [R, F], as float because missing values stay NaN."""
        numbers = np.empty(values.shape, np.float32)
        for place, (edges, column) in enumerate(zip(self._edges, values.T, strict=True)):
            missing = np.isnan(column)
            numbers[:, place] = np.searchsorted(edges, column)
            # A column that is missing throughout says nothing, and scikit-learn does not accept it.
            numbers[missing, place] = 0 if missing.all() else np.nan
        return numbers

    def thresholds(self, column: NDArray[np.int32], threshold: NDArray[np.float64]) -> NDArray[np.float64]:
        """Thresholds between values, of finite thresholds between numbers of bins of the given columns (same shape).

        Each is the end of the bin below it.
        """
        below = threshold.astype(np.int64)
        found = [self._edges[of][number] for of, number in zip(column.flat, below.flat, strict=True)]
        return np.array(found, np.float64).reshape(threshold.shape)


def _edges(column: NDArray[np.float32], weight: NDArray[np.float64]) -> NDArray[np.float64]:
    """The ascending ends of all bins of a column but the last, which has none."""
    known = ~np.isnan(column)
    order = np.argsort(column[known], kind="stable")
    value, weight = column[known][order].astype(np.float64), weight[known][order]
    distinct = np.unique(value)
    if len(distinct) <= MAX_BINS:
        return (distinct[1:] + distinct[:-1]) / 2
    total = np.cumsum(weight)
    wanted = np.linspace(0, 100, MAX_BINS + 1)[1:-1] / 100 * total[-1]
    place = np.minimum(np.searchsorted(total, wanted), len(value) - 1)
    return np.unique(value[place])
