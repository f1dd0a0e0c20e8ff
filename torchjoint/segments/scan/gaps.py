"""Step 6, method scan: which of a scan's points are connected over the gaps that are allowed between them."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint.ops import nearest_neighbors
from torchjoint.ops.internal import gap_components
from torchjoint.runtime.threads import all_threads

#: Neighbours of a point. Where points are dense, few neighbours connect them over less than the allowed gap. This keeps
#: things apart that stand side by side. With fewer, thin parts between denser ones are lost; more take longer.
NEIGHBORS = 12

#: Largest distance over which a small segment is joined to a neighbour, in allowed gaps. Farther away it is mostly
#: another object. A person at 40 m has as few points as a crumb: 2 joined many of them to what they stand beside.
JOINING_GAP = 1.1
#: Largest distance of neighbours, in allowed gaps: what is farther away is never joined. Larger by rounding errors.
LIMIT = JOINING_GAP * (1 + 1e-9)


class Gaps(NamedTuple):
    """Some points of a scan of N points, searched for neighbours once."""

    which: Tensor  #: [S] int64, numbers of the points
    points: Tensor  #: [S, 3] float32 metres
    gap: Tensor  #: [S] float64 metres that each allows
    neighbors: Tensor  #: [S, K] int32, within LIMIT gaps; the point itself where there are fewer

    @classmethod
    def of(cls, points: Tensor, gap: Tensor, which: Tensor) -> Gaps:
        """The points `which` of all points [N, 3] float32, and of their gaps [N] float64."""
        some, own = points[which], gap[which]
        with all_threads():
            return cls(which, some, own, nearest_neighbors(some, NEIGHBORS, 0, LIMIT * own)[0])

    def components(self, among: Tensor, min_size: int = 0) -> Tensor:
        """Labels [N] int64 of the components of the points `among` [N] bool: 1, 2, ...; 0 for other points.

        A component of fewer than `min_size` points is joined to the one that is nearest in allowed gaps, if it is at
        most JOINING_GAP of them away.
        """
        used = among[self.which]
        with all_threads():
            found = gap_components(self.points, self.gap, self.neighbors, used, min_size, JOINING_GAP)
        labels = torch.zeros(len(among), dtype=torch.int64)
        labels[self.which] = torch.where(used, found + 1, 0)
        return labels
