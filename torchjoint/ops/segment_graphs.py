"""The pixel graphs of single segments of an image."""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor

from torchjoint.ops._checks import check_array, check_number


def segment_graphs(
    labels: Tensor, chosen: Tensor, colors: Tensor, boundary: Tensor, color_weight: float, boundary_weight: float
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Build the 8-connected pixel graphs of some segments, each by itself.

    The weight of an edge is ``w = color_weight |c_i - c_j| + boundary_weight min(b_i, b_j)`` (eq. 2 of the paper) in
    float32, taken relative to the mean w over its segment's edges, as eq. 14 needs it.

    Args:
        labels: ``[H, W]`` int32, segment of each pixel, -1 = none.
        chosen: ``[K]`` bool, the segments wanted; labels are below K.
        colors: ``[3, H, W]`` float32.
        boundary: ``[H, W]`` float32.
        color_weight, boundary_weight: w_c and w_b, >= 0.

    Returns:
        The graphs of the C chosen segments in the order of their labels, one after the other:
        ``pixel`` ``[n]`` int64, row x W + column of the nodes, ascending within a segment; those of the s-th segment
        are ``node_ptr[s] : node_ptr[s + 1]``, ``node_ptr`` ``[C + 1]`` int64.
        ``edge_index`` ``[2, e]`` int64, nodes numbered within their segment, each edge once: all to the right, then
        down, down-right and up-right, in the order of their first ends; those of the s-th segment are
        ``edge_ptr[s] : edge_ptr[s + 1]``. ``relative_weight`` ``[e]`` float64, 0 where the mean is 0. No gradient
        flows.

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
    result = torch.ops.torchjoint.segment_graphs.default(
        labels, chosen, colors.detach(), boundary.detach(), float(color_weight), float(boundary_weight)
    )
    return cast(tuple[Tensor, Tensor, Tensor, Tensor, Tensor], result)


@torch.library.register_fake("torchjoint::segment_graphs")
def _fake(
    labels: Tensor, chosen: Tensor, colors: Tensor, boundary: Tensor, color_weight: float, boundary_weight: float
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
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
