"""Step 5: overlap of the label windows around the two ends of an edge (eq. 5)."""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor

from torchjoint.ops._call import call
from torchjoint.ops._checks import check_array, check_number, check_visible_edges


def window_overlaps(
    order: Tensor,
    other_end: Tensor,
    start: Tensor,
    point: Tensor,
    row: Tensor,
    column: Tensor,
    labels: Tensor,
    window: int,
) -> tuple[Tensor, Tensor]:
    """Compare the labels around the two ends of an edge, for all edges with two visible ends.

    The overlap of two windows is their histogram intersection divided by the size of the smaller window (eq. 5 of the
    paper). Windows are clipped at the image border, and pixels without a label do not count. The running time depends
    on the edges of the visible points, not on the size of the graph. ``order``, ``other_end`` and ``start`` are the CSR
    adjacency of the graph (:class:`torchjoint.cloud.adjacency.CsrAdjacency`).

    Args:
        order: ``[E]`` int32, edge numbers, sorted by the edges' first nodes; each undirected edge once.
        other_end: ``[E]`` int32, the second node of each edge, in the same order.
        start: ``[N + 1]`` int32, the place in ``order`` where the edges of each of the N nodes start.
        point: ``[M]`` int64, the nodes that the image sees, each once.
        row, column: ``[M]`` int64, the pixels that contain these nodes.
        labels: ``[H, W]`` int32, negative = none.
        window: side of the windows, pixels, odd.

    Returns:
        ``edge`` ``[S]`` int64, the edges with two visible ends and a labelled pixel in both windows; ``overlap``
        ``[S]`` float64 in [0, 1]. In the order of ``point``, then of ``order``.

    Raises:
        TypeError: an argument of the wrong type or dtype.
        ValueError: a wrong shape or device, a number out of range, a point given twice, an even window.

    Example:
        >>> import torch
        >>> order, other_end, start = (torch.tensor(x).int() for x in ([0, 1, 2], [1, 2, 2], [0, 2, 3, 3]))
        >>> point, row, column = torch.tensor([0, 2]), torch.tensor([0, 0]), torch.tensor([1, 2])
        >>> labels = torch.tensor([[7, 7, 8, 8]]).int()
        >>> window_overlaps(order, other_end, start, point, row, column, labels, window=3)
        (tensor([1]), tensor([0.6667], dtype=torch.float64))
    """
    check_visible_edges(order, other_end, start, point, row, column)
    check_array("labels", labels, torch.int32, (None, None), "[H, W]")
    check_number("window", window, (int,))
    result = call(
        torch.ops.torchjoint.window_overlaps.default, order, other_end, start, point, row, column, labels, window
    )
    return cast(tuple[Tensor, Tensor], result)


@torch.library.register_fake("torchjoint::window_overlaps")
def _fake(order: Tensor, *_: object) -> tuple[Tensor, Tensor]:
    count = torch.library.get_ctx().new_dynamic_size()
    return order.new_empty(count, dtype=torch.int64), order.new_empty(count, dtype=torch.float64)
