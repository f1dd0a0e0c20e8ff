"""Connected components of a graph, for example of merged segments or stitched tiles."""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor

from torchjoint.ops._call import call
from torchjoint.ops._checks import check_edge_index, check_num_nodes


def connected_components(edge_index: Tensor, num_nodes: int) -> Tensor:
    """Label the connected components of a graph: two nodes have the same label if a path of edges connects them.

    Args:
        edge_index: ``[2, E]`` int64, undirected edges. Self loops and repeated edges have no effect.
        num_nodes: number of nodes N, below 2^31.

    Returns:
        ``[N]`` int64 labels 0, 1, 2, ... in the order of their first node.

    Raises:
        TypeError: an argument of the wrong type or dtype.
        ValueError: a wrong shape or device, a node number outside [0, N), a negative number.

    Example:
        >>> import torch
        >>> connected_components(torch.tensor([[3, 1], [0, 4]]), num_nodes=5)
        tensor([0, 1, 2, 0, 1])
    """
    check_edge_index(edge_index)
    check_num_nodes(num_nodes)
    return cast(Tensor, call(torch.ops.torchjoint.connected_components.default, edge_index, num_nodes))


@torch.library.register_fake("torchjoint::connected_components")
def _fake(edge_index: Tensor, num_nodes: int) -> Tensor:
    return edge_index.new_empty(num_nodes)
