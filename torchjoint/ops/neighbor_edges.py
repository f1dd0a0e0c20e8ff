"""Step 3: the undirected edges of a table of nearest neighbours."""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor

from torchjoint.ops._call import call
from torchjoint.ops._checks import check_neighbors, check_order


def neighbor_edges(neighbors: Tensor, order: Tensor | None = None) -> Tensor:
    """Make the edges of a table of neighbours: i < j have one edge if i is in the row of j, or j in the row of i.

    The edges have the order of their first occurrence in the table. A row that contains its own point gives no edge. A
    row that contains a neighbour twice gives this edge twice (:func:`torchjoint.ops.felzenszwalb` accepts this).

    Args:
        neighbors: ``[N, K]`` int32 or int64, N < 2^31: the neighbours of each point.
        order: ``[N]`` int32, a permutation: the order in which rows are processed; the result does not depend on it.
            For a large cloud in random order, a spatial one (:func:`ascending_order` of its cells) is much faster.
            Default: 0, 1, ...

    Returns:
        ``[2, E]`` int64. Runs on torch's threads; the result does not depend on the number of threads.

    Raises:
        TypeError: an argument of the wrong type or dtype.
        ValueError: a wrong shape or device, a neighbour outside [0, N), an order that is no permutation.

    Example:
        >>> import torch
        >>> neighbor_edges(torch.tensor([[1], [0], [1]]))
        tensor([[0, 1],
                [1, 2]])
    """
    check_neighbors(neighbors, None)
    check_order(order, neighbors.shape[0])
    return cast(Tensor, call(torch.ops.torchjoint.neighbor_edges.default, neighbors, order))


@torch.library.register_fake("torchjoint::neighbor_edges")
def _fake(neighbors: Tensor, order: Tensor | None = None) -> Tensor:
    num_edges = torch.library.get_ctx().new_dynamic_size()
    return neighbors.new_empty((2, num_edges), dtype=torch.int64)
