"""gap_components: the slow twin, and arguments that are right and wrong."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from reference.arguments import NEIGHBORS, POINTS

GAP = torch.tensor([1.0, 0.5, 1.0, 2.0], dtype=torch.float64)
USED = torch.tensor([True, True, True, True])
EXAMPLE: dict[str, Any] = {
    "points": POINTS, "gap": GAP, "neighbors": NEIGHBORS, "used": USED, "min_size": 2, "joining": 2.0,
}  # fmt: skip
ERRORS = [
    ({"points": POINTS.double()}, ValueError, "points: expected another dtype"),
    ({"points": POINTS[:, :2]}, ValueError, "points: expected length 3 in dimension 1, got 2"),
    ({"gap": GAP[:3]}, ValueError, "gap: expected length 4 in dimension 0, got 3"),
    ({"gap": -GAP}, ValueError, "gap: expected numbers >= 0, got -1 at 0"),
    ({"neighbors": NEIGHBORS + 2}, ValueError, "neighbors: expected numbers in [0, 4), got 4 at"),
    ({"neighbors": NEIGHBORS[:3]}, ValueError, "neighbors: expected 4 rows, got 3"),
    ({"used": GAP}, ValueError, "used: expected another dtype"),
    ({"min_size": -1}, ValueError, "min_size: expected a number >= 0, got -1"),
    ({"joining": 0.5}, ValueError, "joining: expected a number >= 1, got 0.5"),
]
REFUSED = [{"points": POINTS.double()}, {"gap": GAP[:3]}, {"neighbors": NEIGHBORS[:3]}, {"gap": -GAP}]


def gap_components_reference(
    points: Tensor, gap: Tensor, neighbors: Tensor, used: Tensor, min_size: int = 0, joining: float = 1.0
) -> Tensor:
    """What :func:`torchjoint.ops.internal.gap_components` does; the arguments are not checked."""
    edges = []
    for u, row in enumerate(neighbors.tolist()):
        for v in row:
            if used[u] and used[v]:
                x, y, z = (points[u].double() - points[v].double()).tolist()
                least = min(float(gap[u]), float(gap[v]))
                squared = (x * x + y * y) + z * z
                weight = squared / (least * least) if least > 0 else float("inf")
                edges.append((weight, min(u, v), max(u, v)))
    component = list(range(len(points)))

    def join(u: int, v: int) -> None:
        component[:] = [component[u] if other == component[v] else other for other in component]

    for weight, u, v in edges:
        if weight <= 1:
            join(u, v)
    for weight, u, v in sorted(edges):
        a, b = component[u], component[v]
        if weight <= joining * joining and a != b and min(component.count(a), component.count(b)) < min_size:
            join(u, v)
    first = list(dict.fromkeys(component))
    return torch.tensor([first.index(label) for label in component], dtype=torch.int64)
