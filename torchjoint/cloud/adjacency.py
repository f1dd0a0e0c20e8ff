"""Step 5: the edges of the point graph in CSR form (compressed sparse rows).

CSR means here: the edges are sorted by their first point i, and ``start[i] : start[i + 1]`` are the places of the edges
of point i in this order. Each undirected edge occurs once, with i < j.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor


class CsrAdjacency(NamedTuple):
    """CSR adjacency of a graph. It gives the edges of some points without a pass over all edges."""

    order: Tensor  #: [E] int32, edge numbers, sorted by the edges' first points
    other_end: Tensor  #: [E] int32, the second point of each edge, in the same order
    start: Tensor  #: [N + 1] int32, the place in `order` where the edges of each point start

    @classmethod
    def of(cls, edge_index: Tensor, num_points: int) -> CsrAdjacency:
        """Sorts the edges of a graph.

        Args:
            edge_index: [2, E] int64, each undirected edge once.
            num_points: N.
        """
        order = torch.argsort(edge_index[0], stable=True)
        start = torch.zeros(num_points + 1, dtype=torch.int32)
        start[1:] = torch.cumsum(torch.bincount(edge_index[0], minlength=num_points), 0)
        return cls(order.to(torch.int32), edge_index[1, order].to(torch.int32), start)
