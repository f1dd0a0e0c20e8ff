"""Step 5: the largest pixel on the line between the two ends of an edge."""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor

from torchjoint.ops._call import call
from torchjoint.ops._checks import check_array, check_visible_edges


def line_maxima(
    order: Tensor, other_end: Tensor, start: Tensor, point: Tensor, row: Tensor, column: Tensor, image: Tensor
) -> tuple[Tensor, Tensor]:
    """Find the largest pixel of an image between the two ends of an edge, for all edges with two visible ends.

    The image is read at the pixels of both ends, and at a quarter, a half and three quarters of the line between them.
    These positions are rounded to the nearest pixel, ties to the even row or column. ``order``,
    ``other_end`` and ``start`` are the CSR adjacency of the graph, as for :func:`torchjoint.ops.window_overlaps`.

    Args:
        order: ``[E]`` int32, edge numbers, sorted by the edges' first nodes; each undirected edge once.
        other_end: ``[E]`` int32, the second node of each edge, in the same order.
        start: ``[N + 1]`` int32, the place in ``order`` where the edges of each of the N nodes start.
        point: ``[M]`` int64, the nodes that the image sees, each once.
        row, column: ``[M]`` int64, the pixels that contain these nodes.
        image: ``[H, W]`` uint8.

    Returns:
        ``edge`` ``[S]`` int64, the edges with two visible ends; ``maximum`` ``[S]`` uint8. In the order of ``point``,
        then of ``order``.

    Raises:
        TypeError: an argument of the wrong type or dtype.
        ValueError: a wrong shape or device, a number out of range, a point given twice.

    Example:
        >>> import torch
        >>> order, other_end, start = (torch.tensor(x).int() for x in ([0, 1, 2], [1, 2, 2], [0, 2, 3, 3]))
        >>> point, row, column = torch.tensor([0, 2]), torch.tensor([0, 0]), torch.tensor([0, 4])
        >>> line_maxima(order, other_end, start, point, row, column, torch.tensor([[1, 5, 2, 7, 3]]).byte())
        (tensor([1]), tensor([7], dtype=torch.uint8))
    """
    check_visible_edges(order, other_end, start, point, row, column)
    check_array("image", image, torch.uint8, (None, None), "[H, W]")
    result = call(torch.ops.torchjoint.line_maxima.default, order, other_end, start, point, row, column, image)
    return cast(tuple[Tensor, Tensor], result)


@torch.library.register_fake("torchjoint::line_maxima")
def _fake(order: Tensor, *_: object) -> tuple[Tensor, Tensor]:
    count = torch.library.get_ctx().new_dynamic_size()
    return order.new_empty(count, dtype=torch.int64), order.new_empty(count, dtype=torch.uint8)
