"""Step 7, method cuts: minimum cut between a source and a sink."""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor

from torchjoint.ops._call import call
from torchjoint.ops._checks import check_edge_index, check_vector


def min_cut(
    edge_index: Tensor, capacity: Tensor, source_capacity: Tensor, sink_capacity: Tensor
) -> tuple[Tensor, Tensor]:
    """Compute the minimum s-t cut of a graph with the smallest possible source side.

    Every node has, besides its edges, a link to the source and a link to the sink. The source side consists of the
    nodes that the source reaches in the residual graph of a maximum flow. The source side of every other minimum cut
    contains it. The algorithm is preflow-push (A. Goldberg, R. Tarjan, J. ACM 1988) with highest-label selection, gap
    heuristic and global relabelling (B. Cherkassky, A. Goldberg, Algorithmica 1997). Nodes far above their last exact
    label wait for the next global relabelling, and leaves are pruned in advance; so long thin graphs do not take
    quadratic time.

    Capacities are first rounded to integers, so that sums are exact and the result is deterministic. With M the
    largest capacity of an edge, E < 2^b and M < 2^e, the unit is 2^(b+e-60): for a million edges, less than 2e-12 M.
    Zero stays zero, and a positive capacity stays positive. Integers up to 2^60 / 2^b are exact. At each node only the
    difference of the two terminal capacities is rounded.

    Args:
        edge_index: ``[2, E]`` int64, undirected edges, E < 2^30. Self loops are ignored, parallel edges add up.
        capacity: ``[E]`` float32 or float64, the cost of cutting each edge: finite, >= 0.
        source_capacity: ``[N]`` float32 or float64, the cost of putting each node on the sink side; ``inf`` makes
            the node a seed of the source side.
        sink_capacity: ``[N]`` float32 or float64, the cost of putting each node on the source side; ``inf`` makes
            the node a seed of the sink side.

    Returns:
        ``source_side`` ``[N]`` bool, and ``flow``, a float64 scalar: the cost of this cut in the given capacities,
        which equals the maximum flow. No gradient flows through them.

    Raises:
        TypeError: an argument of the wrong type or dtype.
        ValueError: a wrong shape or device, a node number outside [0, N), a NaN or negative capacity, an infinite
            edge, a node with both terminal capacities infinite.

    Example:
        >>> import torch
        >>> edge_index = torch.tensor([[0, 1, 2], [1, 2, 3]])
        >>> source = torch.tensor([torch.inf, 0.0, 0.0, 0.0])
        >>> sink = torch.tensor([0.0, 0.0, 0.0, torch.inf])
        >>> min_cut(edge_index, torch.tensor([3.0, 1.0, 2.0]), source, sink)
        (tensor([ True,  True, False, False]), tensor(1., dtype=torch.float64))
    """
    check_edge_index(edge_index)
    check_vector("capacity", capacity, edge_index.shape[1], "E")
    check_vector("source_capacity", source_capacity, None, "N")
    check_vector("sink_capacity", sink_capacity, source_capacity.shape[0], "N")
    result = call(
        torch.ops.torchjoint.min_cut.default,
        edge_index,
        capacity,
        source_capacity,
        sink_capacity,
    )
    return cast(tuple[Tensor, Tensor], result)


@torch.library.register_fake("torchjoint::min_cut")
def _fake(
    edge_index: Tensor, capacity: Tensor, source_capacity: Tensor, sink_capacity: Tensor
) -> tuple[Tensor, Tensor]:
    side = source_capacity.new_empty(source_capacity.shape, dtype=torch.bool)
    return side, source_capacity.new_empty((), dtype=torch.float64)
