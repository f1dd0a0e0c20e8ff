"""Reference versions of the operators on regions (step 6); shapes and units are those of the operators."""

from __future__ import annotations

import math

import torch
from torch import Tensor


def ascending_order_reference(values: Tensor) -> Tensor:
    """What :func:`torchjoint.ops.ascending_order` computes, by comparisons; the argument is not checked."""
    numbers = values.tolist()
    missing = [math.isnan(number) for number in numbers]
    order = sorted(range(len(numbers)), key=lambda i: (missing[i], 0.0 if missing[i] else numbers[i], i))
    return torch.tensor(order, dtype=torch.int32)


def group_summaries_reference(
    values: Tensor, order: Tensor, group: Tensor, num_groups: int, quantiles: Tensor
) -> Tensor:
    """What :func:`torchjoint.ops.group_summaries` computes, by sorting each group; the arguments are not checked."""
    result = torch.full((num_groups, 1 + len(quantiles)), torch.nan, dtype=torch.float64)
    for number in range(num_groups):
        inside = values[(group == number) & values.isfinite()]
        if len(inside):
            total = 0.0
            for value in inside.tolist():
                total += value
            places = (quantiles * (len(inside) - 1)).round().long()
            result[number, 0] = total / len(inside)
            result[number, 1:] = inside.sort().values[places].double()
    return result


def merge_regions_reference(
    edge_index: Tensor, cost: Tensor, size: Tensor, threshold: float, min_size: int = 0
) -> Tensor:
    """What :func:`torchjoint.ops.merge_regions` computes; the arguments are not checked.

    Example:
        >>> edge_index = torch.tensor([[0, 0, 1, 1], [1, 1, 2, 2]])
        >>> merge_regions_reference(edge_index, torch.tensor([0.0, 0.2, 0.1, 0.9]), torch.ones(3).long(), 0.3)
        tensor([0, 0, 1])
    """
    group = [[region] for region in range(len(size))]  # for each region, the regions merged into it
    costs: dict[frozenset[int], list[float]] = {}  # costs of each boundary, by the first regions of its two groups
    for (a, b), value in zip(edge_index.t().tolist(), cost.double().tolist(), strict=True):
        if a != b:
            costs.setdefault(frozenset((a, b)), []).append(round(value * 2**20) / 2**20)
    number = {sides: i for i, sides in enumerate(costs)}

    def mean(sides: frozenset[int]) -> float:
        return sum(costs[sides]) / len(costs[sides])

    def total(region: int) -> int:
        return sum(int(size[member]) for member in group[region])

    def merge(sides: frozenset[int]) -> None:
        kept, given = sorted(sides)
        group[kept] += group[given]
        group[given] = []
        del costs[sides]
        for old in [other for other in costs if given in other]:
            now = old - {given} | {kept}
            number[now] = min(number.get(now, number[old]), number[old]) if now in costs else number[old]
            costs[now] = costs.get(now, []) + costs.pop(old)

    for is_small in (False, True):
        while True:
            may_merge = [
                sides
                for sides in costs
                if (any(total(region) < min_size for region in sides) if is_small else mean(sides) <= threshold)
            ]
            if not may_merge:
                break
            merge(min(may_merge, key=lambda sides: (mean(sides), number[sides])))
    labels = torch.empty(len(size), dtype=torch.int64)
    for label, members in enumerate(members for members in group if members):
        labels[members] = label
    return labels


def region_dendrogram_reference(
    edge_index: Tensor, cost: Tensor, num_regions: int, threshold: float
) -> tuple[Tensor, Tensor]:
    """What :func:`torchjoint.ops.region_dendrogram` computes; the arguments are not checked.

    Example:
        >>> edge_index = torch.tensor([[0, 1, 0], [1, 2, 2]])
        >>> region_dendrogram_reference(edge_index, torch.tensor([0.0, 0.25, 0.75]), 3, 1.0)
        (tensor([[0, 0],
                [1, 2]]), tensor([0.0000, 0.5000], dtype=torch.float64))
    """
    costs: dict[tuple[int, int], list[float]] = {}  # of each boundary, by the lowest regions of its two groups
    for (a, b), value in zip(edge_index.t().tolist(), cost.double().tolist(), strict=True):
        if a != b:
            costs.setdefault((min(a, b), max(a, b)), []).append(round(value * 2**20) / 2**20)
    number = {pair: i for i, pair in enumerate(costs)}  # of each boundary
    merges: list[tuple[int, int]] = []
    means: list[float] = []
    while costs:
        mean, _, (kept, given) = min((sum(values) / len(values), number[pair], pair) for pair, values in costs.items())
        if mean > threshold:
            break
        merges.append((kept, given))
        means.append(mean)
        del costs[kept, given]
        for old in [pair for pair in costs if given in pair]:
            other = old[0] + old[1] - given
            now = (min(kept, other), max(kept, other))
            number[now] = min(number[old], number[now]) if now in costs else number[old]
            costs[now] = costs.get(now, []) + costs.pop(old)
    return torch.tensor(merges, dtype=torch.int64).view(-1, 2).t(), torch.tensor(means, dtype=torch.float64)


def region_planes_reference(
    points: Tensor, neighbors: Tensor, region: Tensor, normals: Tensor, min_points: int = 6
) -> tuple[Tensor, Tensor]:
    """What :func:`torchjoint.ops.region_planes` computes; the arguments are not checked.

    If a neighbourhood varies least in more than one direction, the result may be any of these directions.

    Example:
        >>> points = torch.tensor([[0.0, 0, 0], [0, 1, 0], [0, 0, 1]])
        >>> neighbors, up = torch.tensor([[1, 2], [0, 2], [0, 1]]), torch.tensor([[-1.0, 0, 1]]).expand(3, 3)
        >>> region_planes_reference(points, neighbors, torch.zeros(3).long(), up, 3)[1][0] + 0.0
        tensor([-1.,  0.,  0.])
    """
    means, fitted = points.clone(), normals.clone()
    for i, row in enumerate(neighbors.long()):
        own = torch.cat([torch.tensor([i]), row[region[row] == region[i]]])
        around = points[own].double()
        means[i] = around.mean(dim=0).float()
        if len(own) >= min_points:
            centred = around - around.mean(dim=0)
            normal = torch.linalg.eigh(centred.t() @ centred)[1][:, 0]
            fitted[i] = (normal if normal @ normals[i].double() >= 0 else -normal).float()
    return means, fitted


def mask_merges_reference(
    edge_index: Tensor,
    cost: Tensor,
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
    """What :func:`torchjoint.ops.mask_merges` computes; the arguments are not checked.

    Example:
        >>> edge_index, in_frame = torch.tensor([[0], [1]]), torch.tensor([[0, 1], [0, 0], [2, 3]])
        >>> in_mask, weight, frame = torch.tensor([[0, 1], [0, 0], [2, 1]]), torch.tensor([256]), torch.tensor([0])
        >>> mask_merges_reference(
        ...     edge_index, torch.ones(1), torch.tensor([2, 3]), in_mask, in_frame, weight, frame, 1.0, 1.0, 1.0
        ... )  # of six pairs, two agree and four have one point in the mask: (4 / 12 + 1) / (2 / 6 + 4 / 12 + 1)
        (tensor([[0],
                [1]]), tensor([0.8000], dtype=torch.float64))
    """
    points_in: dict[tuple[int, int], int] = {}
    seen_in: dict[tuple[int, int], int] = {}
    for table, rows in ((points_in, in_mask), (seen_in, in_frame)):
        for region, key, count in rows.t().tolist():
            table[region, key] = table.get((region, key), 0) + count
    weights, frames = weight.tolist(), frame_of_mask.tolist()
    group = [[region] for region in range(len(size))]
    costs: dict[tuple[int, int], list[float]] = {}  # of each boundary, by the lowest regions of its two groups
    for (a, b), value in zip(edge_index.t().tolist(), cost.double().tolist(), strict=True):
        if a != b:
            costs.setdefault((min(a, b), max(a, b)), []).append(round(value * 2**20))
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
        prior = sum(costs[a, b]) / len(costs[a, b]) / 2**20
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
            costs[now] = costs.get(now, []) + costs.pop(old)
    return torch.tensor(merges, dtype=torch.int64).view(-1, 2).t(), torch.tensor(values, dtype=torch.float64)
