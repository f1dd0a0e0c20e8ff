"""Step 7, method cuts: the pixel graphs of single segments of an image."""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor

from torchjoint.ops._call import call
from torchjoint.ops._checks import check_array, check_number


def segment_graphs(
    labels: Tensor, chosen: Tensor, colors: Tensor, boundary: Tensor, color_weight: float, boundary_weight: float
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Build a separate 8-connected pixel graph for each chosen segment.

    The weight of an edge is ``w = color_weight |c_i - c_j| + boundary_weight min(b_i, b_j)`` (eq. 2 of the paper) in
    float32, divided by the mean w over the edges of its segment (eq. 14).

    Args:
        labels: ``[H, W]`` int32, segment of each pixel, -1 = none.
        chosen: ``[K]`` bool, the chosen segments; labels are below K.
        colors: ``[3, H, W]`` float32.
        boundary: ``[H, W]`` float32.
        color_weight, boundary_weight: w_c and w_b, >= 0.

    Returns:
        The graphs of the C chosen segments, one after the other, in the order of their labels:
        ``pixel`` ``[n]`` int64, row x W + column of the nodes, ascending within a segment; ``node_ptr`` ``[C + 1]``
        int64; the nodes of the s-th segment are ``node_ptr[s] : node_ptr[s + 1]``.
        ``edge_index`` ``[2, e]`` int64, node numbers within the segment, each edge once: first all edges to the right,
        then down, down-right and up-right, in the order of their first nodes; ``edge_ptr`` ``[C + 1]`` int64; the edges
        of the s-th segment are ``edge_ptr[s] : edge_ptr[s + 1]``.
        ``relative_weight`` ``[e]`` float64, 0 if the mean is 0. No gradient flows through them.

        The tuple is (pixel, node_ptr, edge_index, edge_ptr, relative_weight).

    Raises:
        TypeError: an argument of the wrong type or dtype.
        ValueError: a wrong shape or device, a label outside [-1, K), a negative weight.

    Example:
        >>> import torch
        >>> labels, colors = torch.tensor([[0, 1, 1, 1]]).int(), torch.zeros(3, 1, 4)
        >>> colors[0, 0] = torch.tensor([0.0, 0.0, 0.1, 0.4])
        >>> chosen = torch.tensor([False, True])
        >>> pixel, node_ptr, edge_index, edge_ptr, relative_weight = segment_graphs(
        ...     labels, chosen, colors, torch.zeros(1, 4), 1.0, 0.0
        ... )
        >>> pixel, edge_index.tolist(), relative_weight
        (tensor([1, 2, 3]), [[0, 1], [1, 2]], tensor([0.5000, 1.5000], dtype=torch.float64))
        >>> node_ptr, edge_ptr
        (tensor([0, 3]), tensor([0, 2]))
    """
    check_array("labels", labels, torch.int32, (None, None), "[H, W]")
    height, width = labels.shape
    check_array("chosen", chosen, torch.bool, (None,), "[K]")
    check_array("colors", colors, torch.float32, (3, height, width), f"[3, H, W] = [3, {height}, {width}]")
    check_array("boundary", boundary, torch.float32, (height, width), f"[H, W] = [{height}, {width}]")
    check_number("color_weight", color_weight, (int, float))
    check_number("boundary_weight", boundary_weight, (int, float))
    result = call(
        torch.ops.torchjoint.segment_graphs.default,
        labels,
        chosen,
        colors,
        boundary,
        float(color_weight),
        float(boundary_weight),
    )
    return cast(tuple[Tensor, Tensor, Tensor, Tensor, Tensor], result)


@torch.library.register_fake("torchjoint::segment_graphs")
def _fake(labels: Tensor, *_: object) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    context = torch.library.get_ctx()
    num_nodes, num_edges = context.new_dynamic_size(), context.new_dynamic_size()
    num_chosen = context.new_dynamic_size()
    return (
        labels.new_empty(num_nodes, dtype=torch.int64),
        labels.new_empty(num_chosen, dtype=torch.int64),
        labels.new_empty(2, num_edges, dtype=torch.int64),
        labels.new_empty(num_chosen, dtype=torch.int64),
        labels.new_empty(num_edges, dtype=torch.float64),
    )
