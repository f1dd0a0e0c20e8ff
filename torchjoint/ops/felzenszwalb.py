"""Graph-based segmentation of Felzenszwalb and Huttenlocher (IJCV 2004): step 6 and superpoints."""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor

from torchjoint.ops._call import call
from torchjoint.ops._checks import check_edge_index, check_num_nodes, check_number, check_vector


def felzenszwalb(edge_index: Tensor, weight: Tensor, num_nodes: int, scale: float, min_size: int = 0) -> Tensor:
    """Segment a weighted graph: P. Felzenszwalb, D. Huttenlocher, "Efficient Graph-Based Image Segmentation".

    The edges are processed in ascending order of weight, ties in the given order. An edge of weight ``w`` between two
    components joins them if ``w <= min(Int(C1) + scale/|C1|, Int(C2) + scale/|C2|)``, where ``Int(C)`` is the largest
    weight in the minimum spanning tree of ``C`` (0 for a single node). A second pass, in the same order, joins every
    component of fewer than ``min_size`` nodes along its first edge to another component. All arithmetic is in float32,
    and the result is deterministic.

    Args:
        edge_index: ``[2, E]`` int64, undirected edges. Self loops and repeated edges have no effect.
        weight: ``[E]`` float32 or float64 (rounded to float32), the dissimilarity of the two ends. May be negative or
            infinite, but not NaN.
        num_nodes: number of nodes N, below 2^31.
        scale: the paper's k, in units of weight times nodes: larger values give larger segments.
        min_size: components of fewer nodes than this are joined to a neighbour, if they have one.

    Returns:
        ``[N]`` int64 labels 0, 1, 2, ... in the order of their first node. No gradient flows through them.

    Raises:
        TypeError: an argument of the wrong type or dtype.
        ValueError: a wrong shape or device, a node number outside [0, N), a NaN weight, a negative number.

    Example:
        >>> import torch
        >>> edge_index = torch.tensor([[0, 1, 2], [1, 2, 3]])
        >>> felzenszwalb(edge_index, torch.tensor([0.1, 5.0, 0.2]), num_nodes=4, scale=1.0)
        tensor([0, 0, 1, 1])
        >>> felzenszwalb(edge_index, torch.tensor([0.1, 5.0, 0.2]), num_nodes=4, scale=1.0, min_size=3)
        tensor([0, 0, 0, 0])
    """
    check_edge_index(edge_index)
    check_vector("weight", weight, edge_index.shape[1], "E")
    check_num_nodes(num_nodes)
    check_number("scale", scale, (int, float))
    check_number("min_size", min_size, (int,))
    labels = call(torch.ops.torchjoint.felzenszwalb.default, edge_index, weight, num_nodes, float(scale), min_size)
    return cast(Tensor, labels)


@torch.library.register_fake("torchjoint::felzenszwalb")
def _fake(edge_index: Tensor, weight: Tensor, num_nodes: int, scale: float, min_size: int = 0) -> Tensor:
    return edge_index.new_empty(num_nodes)
