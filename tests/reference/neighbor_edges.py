"""neighbor_edges: the slow twin, and arguments that are right and wrong."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from reference.arguments import NEIGHBORS, ROWS, changed
from torchjoint.ops import neighbor_edges

EXAMPLE: dict[str, Any] = {"neighbors": NEIGHBORS, "order": ROWS}
ERRORS = [
    ({"neighbors": [[1], [0]]}, TypeError, "neighbors: expected a torch.Tensor, got list"),
    ({"neighbors": NEIGHBORS.float()}, TypeError, "expected dtype torch.int32 or torch.int64, got"),
    ({"neighbors": NEIGHBORS[0]}, ValueError, "neighbors: expected shape [N, K], got [2]"),
    ({"neighbors": NEIGHBORS.to("meta")}, ValueError, "neighbors: expected a CPU tensor, got one on"),
    ({"neighbors": changed(NEIGHBORS, 4, 2, 1)}, ValueError, "numbers in [0, 4), got 4 in row 2"),
    ({"neighbors": changed(NEIGHBORS, -1, 0, 0).int()}, ValueError, "in [0, 4), got -1 in row 0"),
    ({"neighbors": changed(NEIGHBORS, 2**40, 3, 0)}, ValueError, f"got {2**40} in row 3"),
    ({"order": ROWS.long()}, TypeError, "order: expected dtype torch.int32, got torch.int64"),
    ({"order": ROWS[:3]}, ValueError, "order: expected shape [N] = [4], got [3]"),
    ({"order": changed(ROWS, 4, 2)}, ValueError, "order: expected numbers in [0, 4), got 4 at 2"),
]
REFUSED = [
    {"neighbors": NEIGHBORS.float()},
    {"neighbors": NEIGHBORS[0]},
]


def neighbor_edges_reference(neighbors: Tensor, order: Tensor | None = None) -> Tensor:
    """What :func:`torchjoint.ops.neighbor_edges` computes; the arguments are not checked, and the order does not count.

    Example:
        >>> neighbor_edges_reference(torch.tensor([[1], [0], [1]]))
        tensor([[0, 1],
                [1, 2]])
    """
    num_points, count = neighbors.shape
    neighbors = neighbors.long()
    source = torch.arange(num_points)[:, None].expand(-1, count)
    # (i, j) with i > j is the second occurrence of an edge if i is also in the row of j.
    backward = source > neighbors
    rows, targets = source[backward], neighbors[backward]
    keep = source != neighbors
    keep[backward] = ~(neighbors[targets] == rows[:, None]).any(dim=1)
    i, j = source[keep], neighbors[keep]
    return torch.stack([torch.minimum(i, j), torch.maximum(i, j)])


def long_call(share: float = 1) -> Callable[[], Any]:
    """A call that takes some tenths of a second, or about such a share of that."""
    generator = torch.Generator().manual_seed(0)
    points = torch.rand(int(500_000 * share), 3, generator=generator)
    neighbors = torch.randint(len(points), (len(points), 16), generator=generator)
    return lambda: neighbor_edges(neighbors)
