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
#: Shares of the allowed gap over which parts of things are joined, step by step: the levels of the tree.
LEVELS = tuple(0.3 * 5 ** (number / 8) for number in range(9))
#: Largest distance of neighbours, in allowed gaps: what is farther away is never joined. Larger by rounding errors.
LIMIT = LEVELS[-1] * (1 + 1e-9)


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

    def components(self, among: Tensor, min_size: int = 0, share: float = 1.0) -> Tensor:
        """Labels [N] int64 of the components of the points `among` [N] bool: 1, 2, ...; 0 for other points.

        Points are connected over this `share` of the allowed gap. A component of fewer than `min_size` points is joined
        to the one that is nearest in allowed gaps, if it is at most JOINING_GAP of them away.
        """
        used = among[self.which]
        with all_threads():
            gap, joining = share * self.gap, max(1.0, JOINING_GAP / share)
            found = gap_components(self.points, gap, self.neighbors, used, min_size, joining)
        labels = torch.zeros(len(among), dtype=torch.int64)
        labels[self.which] = torch.where(used, found + 1, 0)
        return labels

    def crossing(self, labels: Tensor, limit: float) -> tuple[Tensor, Tensor]:
        """Neighbours of different labels [N], neither of them 0, at most `limit` gaps apart.

        Returns:
            [2, E] int64 numbers of points, a pair once or twice; [E] float64 their distances, in gaps that both allow.
        """
        own = labels[self.which].int()
        other = own.index_select(0, self.neighbors.flatten()).view_as(self.neighbors)
        row, column = torch.nonzero((other != own[:, None]) & (other * own[:, None] > 0), as_tuple=True)
        ends = torch.stack([row, self.neighbors[row, column].long()])
        apart = self.points[ends].double().diff(dim=0)[0].norm(dim=1) / self.gap[ends].amin(0)
        near = apart <= limit
        return self.which[ends[:, near]], apart[near]
