"""mask_merges: the slow twin, and arguments that are right and wrong."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from reference.arguments import EDGES, NAN, PIXELS, VALUES, changed, large_graph
from torchjoint.ops.internal import mask_merges

EXAMPLE: dict[str, Any] = {
    "edge_index": EDGES, "cost": VALUES.clamp(max=1), "count": torch.tensor([1, 2, 1]),
    "size": torch.tensor([9, 1, 2, 3]),
    "in_mask": torch.tensor([[0, 1, 1], [0, 0, 1], [4, 1, 1]]), "in_frame": torch.tensor([[0, 1], [0, 0], [5, 1]]),
    "weight": torch.tensor([256, 100]), "frame_of_mask": torch.tensor([0, 0]), "apart_weight": 0.6,
    "prior_weight": 0.1, "threshold": 0.5, "stays": torch.tensor([True, False, False, False]), "min_size": 2,
}  # fmt: skip
ERRORS = [
    ({"edge_index": EDGES.int()}, ValueError, "edge_index: expected dtype torch.int64"),
    ({"edge_index": changed(EDGES, 4, 1, 2)}, ValueError, "numbers in [0, 4), got 4 at edge 2"),
    ({"cost": VALUES}, ValueError, "cost: expected numbers in [0, 1], got 5 at edge 1"),
    ({"cost": changed(VALUES / 9, NAN, 1)}, ValueError, "cost: expected numbers in [0, 1], got nan at edge"),
    ({"count": PIXELS[:2]}, ValueError, "count: expected length 3 in dimension 0, got 2"),
    ({"count": torch.tensor([1, 0, 2])}, ValueError, "count: expected numbers in [1, 2^31 - 1], got 0 at edge 1"),
    ({"size": torch.tensor([9, 0, 2, 3])}, ValueError, "size: expected numbers > 0, got 0 at 1"),
    ({"in_mask": torch.tensor([[4], [0], [1]])}, ValueError, "in_mask[0]: expected numbers in [0, 4), got"),
    ({"in_mask": torch.tensor([[0], [2], [1]])}, ValueError, "in_mask[1]: expected numbers in [0, 2), got"),
    ({"in_mask": torch.tensor([[0], [0], [-1]])}, ValueError, "in_mask[2]: expected numbers >= 0, got -1"),
    ({"in_mask": torch.tensor([[2], [0], [1]])}, ValueError, "region 2 has points in mask 0, but in_frame"),
    ({"in_mask": torch.tensor([[0], [0], [6]])}, ValueError, "region 0 has more points in mask 0 than in"),
    ({"in_mask": PIXELS}, ValueError, "in_mask: expected 2 dimensions"),
    ({"in_frame": torch.tensor([[-1], [0], [1]])}, ValueError, "in_frame[0]: expected numbers in [0, 4)"),
    ({"in_frame": torch.tensor([[0], [0], [-1]])}, ValueError, "in_frame[2]: expected numbers >= 0, got"),
    ({"weight": torch.tensor([257, 0])}, ValueError, "weight: expected numbers in [0, 256], got 257 at 0"),
    ({"weight": VALUES[:2]}, ValueError, "weight: expected another dtype"),
    ({"frame_of_mask": PIXELS}, ValueError, "frame_of_mask: expected length 2 in dimension 0, got 3"),
    ({"apart_weight": -1}, ValueError, "apart_weight: expected a finite number >= 0, got -1"),
    ({"prior_weight": 0}, ValueError, "prior_weight: expected a finite number > 0, got 0"),
    ({"prior_weight": torch.inf}, ValueError, "prior_weight: expected a finite number > 0, got inf"),
    ({"apart_weight": torch.inf}, ValueError, "apart_weight: expected a finite number >= 0, got inf"),
    ({"prior_weight": NAN}, ValueError, "prior_weight: expected a finite number > 0, got nan"),
    ({"threshold": "1"}, RuntimeError, "Expected a value of type 'float' for argument 'threshold'"),
    ({"stays": PIXELS}, ValueError, "stays: expected another dtype"),
    ({"stays": PIXELS > 0}, ValueError, "stays: expected length 4 in dimension 0, got 3"),
    ({"min_size": 2.0}, RuntimeError, "Expected a value of type 'int' for argument 'min_size'"),
]
REFUSED = [{"in_mask": EDGES}, {"in_frame": EDGES}, {"weight": VALUES}, {"prior_weight": 0.0}, {"stays": PIXELS}]


def mask_merges_reference(
    edge_index: Tensor,
    cost: Tensor,
    count: Tensor,
    size: Tensor,
    in_mask: Tensor,
    in_frame: Tensor,
    weight: Tensor,
    frame_of_mask: Tensor,
    apart_weight: float,
    prior_weight: float,
    threshold: float,
    stays: Tensor | None = None,
    min_size: int = 0,
) -> tuple[Tensor, Tensor]:
    """What :func:`torchjoint.ops.internal.mask_merges` computes; the arguments are not checked.

    Example:
        >>> edge_index, in_frame = torch.tensor([[0], [1]]), torch.tensor([[0, 1], [0, 0], [2, 3]])
        >>> in_mask, weight, frame = torch.tensor([[0, 1], [0, 0], [2, 1]]), torch.tensor([256]), torch.tensor([0])
        >>> mask_merges_reference(
        ...     edge_index, torch.ones(1), torch.ones(1).long(), torch.tensor([2, 3]), in_mask, in_frame, weight,
        ...     frame, 1.0, 1.0, 1.0,
        ... )  # of six pairs, two agree and four have one point in the mask: (4 / 12 + 1) / (2 / 6 + 4 / 12 + 1)
        (tensor([[0],
                [1]]), tensor([0.8000], dtype=torch.float64))
    """
    points_in: dict[tuple[int, int], int] = {}
    seen_in: dict[tuple[int, int], int] = {}
    for table, rows in ((points_in, in_mask), (seen_in, in_frame)):
        for region, key, points in rows.t().tolist():
            table[region, key] = table.get((region, key), 0) + points
    weights, frames = weight.tolist(), frame_of_mask.tolist()
    group = [[region] for region in range(len(size))]
    # Sum of the costs and number of edges of each boundary, by the lowest regions of its two groups.
    costs: dict[tuple[int, int], tuple[int, int]] = {}
    for (a, b), value, times in zip(edge_index.t().tolist(), cost.double().tolist(), count.tolist(), strict=True):
        if a != b:
            of_both, edges = costs.get((min(a, b), max(a, b)), (0, 0))
            costs[min(a, b), max(a, b)] = of_both + round(value * 2**20) * times, edges + times
    number = {pair: i for i, pair in enumerate(costs)}  # of each boundary

    def total(table: dict[tuple[int, int], int], region: int, key: int) -> int:
        return sum(table.get((member, key), 0) for member in group[region])

    def cost_of(a: int, b: int) -> float:
        agree = differ = 0
        for mask, (s, frame) in enumerate(zip(weights, frames, strict=True)):
            one, other = total(points_in, a, mask), total(points_in, b, mask)
            outside, other_outside = total(seen_in, a, frame) - one, total(seen_in, b, frame) - other
            agree += 2 * s * one * other
            differ += s * (one * other_outside + other * outside)
        pairs = 512.0 * sum(int(size[i]) for i in group[a]) * sum(int(size[i]) for i in group[b])
        prior = float(costs[a, b][0]) / float(costs[a, b][1]) / 2**20
        apart = apart_weight * (differ / pairs)
        return (apart + prior_weight * prior) / (agree / pairs + apart + prior_weight)

    def is_small(region: int) -> bool:
        protected = stays is not None and any(bool(stays[member]) for member in group[region])
        return sum(int(size[member]) for member in group[region]) < min_size and not protected

    merges: list[tuple[int, int]] = []
    values: list[float] = []
    while may_merge := [pair for pair in costs if min_size == 0 or is_small(pair[0]) or is_small(pair[1])]:
        value, _, (kept, given) = min((cost_of(*pair), number[pair], pair) for pair in may_merge)
        if value > threshold:
            break
        merges.append((kept, given))
        values.append(value)
        del costs[kept, given]
        group[kept] += group[given]
        group[given] = []
        for old in [pair for pair in costs if given in pair]:
            other = old[0] + old[1] - given
            now = (min(kept, other), max(kept, other))
            number[now] = min(number[old], number[now]) if now in costs else number[old]
            (of_both, edges), (more, other_edges) = costs.get(now, (0, 0)), costs.pop(old)
            costs[now] = of_both + more, edges + other_edges
    return torch.tensor(merges, dtype=torch.int64).view(-1, 2).t(), torch.tensor(values, dtype=torch.float64)


def long_call(share: float = 1) -> Callable[[], Any]:
    """A call that takes some tenths of a second, or about such a share of that."""
    edges, cost = large_graph(int(10_000 * share))
    rows = torch.stack([torch.arange(len(cost)), torch.arange(len(cost)) % 7, torch.ones(len(cost)).long()])
    weight, frame_of_mask = torch.full((7,), 256), torch.arange(7)
    return lambda: mask_merges(edges, cost, rows[2], rows[2], rows, rows, weight, frame_of_mask, 0.6, 0.1, 0.5)
