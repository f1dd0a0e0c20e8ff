"""agreement_sums: the slow twin, and arguments that are right and wrong."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from reference.arguments import NAN, PIXELS
from torchjoint.ops.internal import agreement_sums

EXAMPLE: dict[str, Any] = {
    "region": torch.tensor([0, 1, 1, 1]).int(), "segment": torch.tensor([0, 0, 1, 2]).int(),
    "num_points": torch.tensor([4, 2, 3, 5]).int(), "segment_size": torch.tensor([6, 4, 5]),
    "frame_of_segment": torch.tensor([0, 0, 2]), "num_regions": 2,
    "pairs": torch.tensor([[0], [1]]), "min_points": 3, "resolution": 0.25,
}  # fmt: skip
ERRORS = [
    ({"region": torch.tensor([0, 1, 2, 1]).int()}, ValueError, "region: expected numbers in [0, 2), got 2 at 2"),
    ({"region": torch.tensor([0, 1, 1, 1])}, ValueError, "region: expected another dtype"),
    ({"segment": torch.tensor([0, 0, -1, 2]).int()}, ValueError, "segment: expected numbers in [0, 3), got -1 at 2"),
    ({"segment": PIXELS.int()}, ValueError, "segment: expected length 4 in dimension 0, got 3"),
    ({"num_points": torch.tensor([4, 2, -3, 5]).int()}, ValueError, "num_points: expected numbers >= 0, got -3 at 2"),
    ({"num_points": torch.tensor([4, 2, 3, 6]).int()}, ValueError, "region 1 has more points in segment 2"),
    ({"segment_size": torch.tensor([6, -1, 5])}, ValueError, "segment_size: expected numbers in [0, 2147483647), got"),
    ({"segment_size": torch.full((3,), 2**31 - 2)}, ValueError, "at most 2^31 - 1 points in a frame, got 4294967292"),
    ({"frame_of_segment": torch.tensor([0, 2, 0])}, ValueError, "frame_of_segment: expected ascending numbers, got 0"),
    ({"frame_of_segment": torch.tensor([-1, 0, 2])}, ValueError, "frame_of_segment: expected numbers in [0, 214748364"),
    ({"frame_of_segment": PIXELS[:2]}, ValueError, "frame_of_segment: expected length 3 in dimension 0, got 2"),
    ({"pairs": torch.tensor([[0], [2]])}, ValueError, "pairs: expected numbers in [0, 2), got 2 at 1"),
    ({"pairs": PIXELS}, ValueError, "pairs: expected 2 dimensions"),
    ({"min_points": 0}, ValueError, "min_points: expected a number > 0, got 0"),
    ({"resolution": 2}, ValueError, "resolution: expected a number in [2^-31, 1], got 2"),
    ({"resolution": NAN}, ValueError, "resolution: expected a number in [2^-31, 1], got nan"),
]
REFUSED = [
    {"region": PIXELS},
    {"num_points": PIXELS.int()},
    {"num_regions": -1},
    {"pairs": PIXELS},
    {"min_points": -1},
    {"resolution": NAN},
]


def agreement_sums_reference(
    region: Tensor,
    segment: Tensor,
    num_points: Tensor,
    segment_size: Tensor,
    frame_of_segment: Tensor,
    num_regions: int,
    pairs: Tensor,
    min_points: int,
    resolution: float,
) -> tuple[Tensor, Tensor, Tensor]:
    """What :func:`torchjoint.ops.internal.agreement_sums` computes; the arguments are not checked."""
    size, frames = segment_size.tolist(), frame_of_segment.tolist()
    points: Counter[tuple[int, int]] = Counter()  # of a region in a segment
    seen: Counter[tuple[int, int]] = Counter()  # of a region in a frame
    for place, number, count in zip(region.tolist(), segment.tolist(), num_points.tolist(), strict=True):
        points[place, number] += count
        seen[place, frames[number]] += count

    def sees(region: int, frame: int) -> bool:
        return seen[region, frame] >= min_points

    best = [0.0] * num_regions
    for (region, number), count in points.items():
        if sees(region, frames[number]):
            best[region] = max(best[region], count / (seen[region, frames[number]] + size[number] - count))

    extremes, sums = [], []
    for one, other in pairs.t().tolist():
        best_union, agreements, rows = 0.0, [], []
        for frame in sorted(set(frames)):
            n, m = seen[one, frame], seen[other, frame]
            if not sees(one, frame) or not sees(other, frame):
                continue
            common = 0
            for number in (number for number in range(len(size)) if frames[number] == frame):
                a, b = points[one, number], points[other, number]
                common += min(a * m, b * n)
                if (one, number) in points and (other, number) in points:
                    best_union = max(best_union, (a + b) / (n + m + size[number] - a - b))
            agreements.append(common / (n * m))
            steps = round(agreements[-1] / resolution)
            rows.append((common, n * m, steps, steps**2, 1))
        extremes.append((best_union, min(agreements, default=torch.inf), max(agreements, default=-torch.inf)))
        sums.append(tuple(map(sum, zip(*rows, strict=True))) if rows else (0,) * 5)
    return (
        torch.tensor(best, dtype=torch.float64),
        torch.tensor(extremes, dtype=torch.float64).view(-1, 3).t(),
        torch.tensor(sums, dtype=torch.int64).view(-1, 5).t(),
    )


def long_call(share: float = 1) -> Callable[[], Any]:
    """A call that takes some tenths of a second, or about such a share of that."""
    generator = torch.Generator().manual_seed(0)
    rows, regions = int(3_000_000 * share), 1000
    region, segment = (torch.randint(top, (rows,), generator=generator).int() for top in (regions, 20_000))
    size, frame = torch.full((20_000,), 2**20), torch.arange(20_000) // 100
    pairs = torch.randint(regions, (2, regions), generator=generator)
    points = torch.ones(rows, dtype=torch.int32)
    return lambda: agreement_sums(
        region, segment, points, size, frame, regions, pairs, min_points=3, resolution=2.0**-24
    )
