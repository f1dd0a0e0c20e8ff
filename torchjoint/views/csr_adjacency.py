"""The edges of the point graph by their first end (compressed sparse rows)."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor


class CsrAdjacency(NamedTuple):
    """The edges of a graph by their first end: an image need only look at the edges of the points it sees."""

    order: Tensor  #: [E] int32, the edges sorted by their first end
    other_end: Tensor  #: [E] int32, the second end of each of them
    start: Tensor  #: [N + 1] int32, where in `order` those of each point start

    @classmethod
    def of(cls, edge_index: Tensor, num_points: int) -> CsrAdjacency:
        """Sorts the edges of a graph."""
        order = torch.argsort(edge_index[0], stable=True)
        start = torch.zeros(num_points + 1, dtype=torch.int32)
        start[1:] = torch.cumsum(torch.bincount(edge_index[0], minlength=num_points), 0)
        return cls(order.to(torch.int32), edge_index[1, order].to(torch.int32), start)
