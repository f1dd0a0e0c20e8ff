"""Step 6, method learned: what is known of the edges between two superpoints, as sums that add up when they merge."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint.cloud.edge_weights import EDGES
from torchjoint.segments.learned.region_statistics import sum_by

#: The measures of an edge, each with the value that divides its bins in two halves of equal number (a typical one):
#:
#: - crease: angle between the planes of the two ends, in right angles, negative where convex
#: - bend: angle between the normals of the two ends, in right angles
#: - wide_bend: the same, with normals fitted to the wider neighbourhoods of the planes
#: - offset: distance of one end's plane to the mean of the other, in multiples of the noise: the smaller one
#: - larger_offset: the larger one
#: - gap: length, in multiples of the spacing
#: - color_step: distance of the colours of the two ends, units of Lab
#: - disagreement: r of eq. 6
#: - contour: strength of the images' boundaries across the edge, mean over those that see both ends
MEASURES = {
    "crease": 0.2, "bend": 0.2, "wide_bend": 0.2, "offset": 1.0, "larger_offset": 2.0, "gap": 1.5, "color_step": 8.0,
    "disagreement": 0.3, "contour": 0.03,
}  # fmt: skip
#: Values of an edge of which a boundary has only the mean: the crease where it is hollow; whether the normal of an end
#: is not oriented; whether an image sees both ends; how many do.
AVERAGED = ("hollow", "unoriented", "seen", "views")
#: Number of bins of a measure. The bins of the crease begin at -1 and all others at 0, see :func:`_bins`.
BINS = 32
_LOWEST = {"crease": -1.0}
#: The histograms of more boundaries are not kept, but computed from the edges, or from those before a merging.
MANY_BOUNDARIES = 200_000


class Boundaries(NamedTuple):
    """The Q boundaries between superpoints. All numbers are sums over their edges."""

    num_edges: Tensor  #: [Q] int64
    averaged: Tensor  #: [Q, A] float64, sums of AVERAGED
    #: For each known measure [Q, 2, BINS] float32: the number of edges in each bin, and the sum of their values; an
    #: edge without a value is in no bin
    binned: Mapping[str, Tensor]

    @classmethod
    def of(cls, pair: Tensor, num_pairs: int, values: dict[str, Tensor]) -> Boundaries:
        """Sums over edges.

        Args:
            pair: [C] int64, boundary of each edge, 0 ... Q - 1.
            num_pairs: Q.
            values: those of MEASURES and AVERAGED that are known, [C] each, NaN = missing.
        """
        averaged = torch.zeros(num_pairs, len(AVERAGED), dtype=torch.float64)
        for number, name in enumerate(AVERAGED):
            if name in values:
                averaged[:, number] = sum_by(pair, values[name].double(), num_pairs)
        measured = [name for name in MEASURES if name in values]
        binned = _Computed(measured, lambda name: _histogram(pair, num_pairs, values[name], name))
        counted = binned if num_pairs > MANY_BOUNDARIES else dict(binned)
        return cls(torch.bincount(pair, minlength=num_pairs), averaged, counted)

    def grouped(self, across: Sequence[Tensor], of_pair: Sequence[Tensor], num_pairs: Sequence[int]) -> Boundaries:
        """Adds boundaries that become one, in several ways; the boundaries of each way follow those of the way before.

        Args:
            across: for each way the numbers [q] int64 of the boundaries that stay.
            of_pair: for each way [q] int64, the new boundary of each of these.
            num_pairs: for each way the number of new boundaries.
        """

        def changed(values: Tensor) -> Tensor:
            ways = zip(across, of_pair, num_pairs, strict=True)
            return torch.cat([sum_by(new, values.index_select(0, kept), count) for kept, new, count in ways])

        binned = _Computed(self.binned, lambda name: changed(self.binned[name]))
        is_kept = isinstance(self.binned, dict) and sum(num_pairs) > MANY_BOUNDARIES  # what it is computed from
        return Boundaries(changed(self.num_edges), changed(self.averaged), binned if is_kept else dict(binned))

    def averages(self) -> dict[str, Tensor]:
        """Mean of each of AVERAGED over the edges, [Q] float64."""
        return dict(zip(AVERAGED, (self.averaged / self.num_edges[:, None]).unbind(1), strict=True))

    def summaries(self, shares: Sequence[float]) -> dict[str, tuple[Tensor, Tensor]]:
        """Mean [Q] float64 and quantiles [Q, len(shares)] float32 of each known measure; NaN without a value.

        The quantile q of n values is the one at place (n - 1) q in ascending order, rounded; instead of it, the mean of
        all values in its bin is given.
        """
        found = {}
        for name, sums in self.binned.items():  # each is read once: it may have to be computed
            binned, total = sums.unbind(1)
            up_to = binned.cumsum(1)
            place = ((up_to[:, -1:] - 1) * up_to.new_tensor(shares)).round()
            bin_ = torch.searchsorted(up_to, place, right=True).clamp_(max=BINS - 1)
            mean = total.sum(1, dtype=torch.float64) / binned.sum(1)
            found[name] = mean, total.gather(1, bin_) / binned.gather(1, bin_)
        return found


class _Computed(Mapping[str, Tensor]):
    """The histograms of measures, each computed whenever it is read."""

    def __init__(self, names: Collection[str], compute: Callable[[str], Tensor]) -> None:
        self._names, self._compute = names, compute

    def __getitem__(self, name: str) -> Tensor:
        return self._compute(name)

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


def _histogram(pair: Tensor, num_pairs: int, values: Tensor, measure: str) -> Tensor:
    """The histogram [Q, 2, BINS] of the values [C] of edges, whose boundaries are `pair` [C]."""
    sums = torch.zeros(num_pairs * 2 * BINS, dtype=torch.float32)
    for start in range(0, len(pair), EDGES):  # less memory than all edges at once
        given = values[start : start + EDGES]
        value = given.nan_to_num(0, 0, 0)
        key = pair[start : start + EDGES] * (2 * BINS) + _bins(value, measure)
        sums.index_add_(0, key, given.isfinite().float())
        sums.index_add_(0, key + BINS, value)
    return sums.view(num_pairs, 2, BINS)


def _bins(values: Tensor, measure: str) -> Tensor:
    """The bin of each value [C], 0 ... BINS - 1.

    The bins are narrow where values are typical, and reach to infinity. All operations round alike on all machines.
    """
    lowest = _LOWEST.get(measure, 0.0)
    return ((values / (values.abs() + MEASURES[measure]) - lowest) / (1 - lowest) * BINS).long().clamp_(0, BINS - 1)
