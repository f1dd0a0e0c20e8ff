"""Step 6, method learned: what is known of the edges between two superpoints, as sums that add up when they merge."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

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
#: The histograms of more boundaries are not kept, but computed from the edges, which take a fifth of the memory.
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
        binned = _Histograms(pair, num_pairs, {name: values[name] for name in MEASURES if name in values})
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

        binned = {name: changed(values) for name, values in self.binned.items()}  # one by one: less memory
        return Boundaries(changed(self.num_edges), changed(self.averaged), binned)

    def means(self) -> dict[str, Tensor]:
        """Mean of each known measure over the edges with a value, [Q] float64, NaN = none; of AVERAGED over all."""
        measured = {
            name: sums[:, 1].sum(1, dtype=torch.float64) / sums[:, 0].sum(1) for name, sums in self.binned.items()
        }
        return measured | dict(zip(AVERAGED, (self.averaged / self.num_edges[:, None]).unbind(1), strict=True))

    def quantiles(self, shares: Sequence[float]) -> dict[str, Tensor]:
        """Quantiles of each known measure, [Q, len(shares)] float32, NaN without a value.

        The quantile q of n values is the one at place (n - 1) q in ascending order, rounded; instead of it, the mean of
        all values in its bin is given.
        """
        found = {}
        for name, sums in self.binned.items():
            binned, total = sums.unbind(1)
            up_to = binned.cumsum(1)
            place = ((up_to[:, -1:] - 1) * up_to.new_tensor(shares)).round()
            bin_ = torch.searchsorted(up_to, place, right=True).clamp_(max=BINS - 1)
            found[name] = total.gather(1, bin_) / binned.gather(1, bin_)
        return found


class _Histograms(Mapping[str, Tensor]):
    """The histograms of measures, each computed from the values of the edges whenever it is read."""

    def __init__(self, pair: Tensor, num_pairs: int, values: dict[str, Tensor]) -> None:
        self._pair, self._num_pairs, self._values = pair, num_pairs, values

    def __getitem__(self, name: str) -> Tensor:
        known, value = self._values[name].isfinite(), self._values[name].nan_to_num(0, 0, 0)
        key = self._pair * BINS + _bins(value, name)
        sums = torch.empty(self._num_pairs, 2, BINS, dtype=torch.float32)
        for number, of_edge in enumerate((known, value)):
            sums[:, number] = torch.bincount(key, of_edge, self._num_pairs * BINS).view(-1, BINS)
        return sums

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)


def _bins(values: Tensor, measure: str) -> Tensor:
    """The bin of each value [C], 0 ... BINS - 1.

    The bins are narrow where values are typical, and reach to infinity. All operations round alike on all machines.
    """
    lowest = _LOWEST.get(measure, 0.0)
    share = (values / (values.abs() + MEASURES[measure]) - lowest) / (1 - lowest)
    return (share * BINS).long().clamp_(0, BINS - 1)
