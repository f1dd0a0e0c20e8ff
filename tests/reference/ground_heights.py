"""ground_heights: the slow twin, and arguments that are right and wrong."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor

from reference.arguments import NAN, changed

AZIMUTH = torch.tensor([-math.pi, -1.0, 0.5, 3.0], dtype=torch.float64)
HEIGHT = torch.tensor([-1.8, -1.7, -0.3, -2.0], dtype=torch.float64)
DISTANCE = torch.tensor([5.0, 8.0, 9.0, 20.0], dtype=torch.float64)
EXAMPLE: dict[str, Any] = {
    "azimuth": AZIMUTH, "elevation": torch.atan2(HEIGHT, DISTANCE), "distance": DISTANCE, "height": HEIGHT,
    "used": torch.tensor([True, True, False, True]), "num_columns": 6, "row_height": 0.01, "slope": 0.2, "step": 0.1,
    "bump": 0.2, "near": 10.0, "blind": 0.75, "sides": 1,
}  # fmt: skip
ERRORS = [
    ({"azimuth": AZIMUTH.float()}, ValueError, "azimuth: expected another dtype"),
    ({"azimuth": AZIMUTH[None]}, ValueError, "azimuth: expected 1 dimensions"),
    ({"azimuth": changed(AZIMUTH, 4, 1)}, ValueError, "azimuth: expected numbers in [-pi, pi], got 4 at 1"),
    ({"elevation": changed(HEIGHT, 2, 0)}, ValueError, "elevation: expected numbers in [-pi/2, pi/2], got 2 at 0"),
    ({"elevation": HEIGHT[:2]}, ValueError, "elevation: expected length 4 in dimension 0, got 2"),
    ({"distance": changed(DISTANCE, -1, 2)}, ValueError, "distance: expected finite numbers >= 0, got -1 at 2"),
    ({"height": changed(HEIGHT, NAN, 3)}, ValueError, "height: expected finite numbers, got nan at 3"),
    ({"used": torch.zeros(4)}, ValueError, "used: expected another dtype"),
    ({"used": torch.zeros(4, dtype=torch.bool)}, ValueError, "used: expected at least one point"),
    ({"num_columns": 0}, ValueError, "num_columns: expected a number > 0, got 0"),
    ({"row_height": 0.0}, ValueError, "row_height: expected a finite number >= 1e-6, got 0"),
    ({"num_columns": 10**6, "row_height": 1e-6}, ValueError, "row_height: expected fewer rows of cells"),
    ({"slope": "steep"}, RuntimeError, "Expected a value of type 'float' for argument 'slope'"),
    ({"bump": NAN}, ValueError, "bump: expected a finite number >= 0, got nan"),
    ({"near": -1.0}, ValueError, "near: expected a number >= 0, got -1"),
    ({"sides": 7}, ValueError, "sides: expected a number in [0, 6], got 7"),
]
REFUSED = [
    {"azimuth": AZIMUTH.float()},
    {"height": HEIGHT[:1]},
    {"used": torch.zeros(4)},
    {"sides": -1},
    {"bump": -1e30},
    {"bump": NAN},
    {"row_height": math.inf},
]

Places = list[tuple[float, float]]


def ground_heights_reference(
    azimuth: Tensor,
    elevation: Tensor,
    distance: Tensor,
    height: Tensor,
    used: Tensor,
    num_columns: int,
    row_height: float,
    slope: float,
    step: float,
    bump: float,
    near: float,
    blind: float,
    sides: int,
) -> Tensor:
    """What :func:`torchjoint.ops.internal.ground_heights` does; the arguments are not checked."""
    d, z, e = distance.tolist(), height.tolist(), elevation.tolist()
    place = [(a + math.pi) / (2 * math.pi) * num_columns for a in azimuth.tolist()]
    column = [min(int(p), num_columns - 1) for p in place]
    some = [i for i in range(len(d)) if used[i]]
    reach = max(near, min(d[i] for i in some))
    lows = [[z[i] for i in some if column[i] == c and d[i] <= reach] for c in range(num_columns)]
    start = lower_median([min(low) for low in lows if low])
    lowest = sorted(e[i] for i in some)[len(some) // 200]
    first = blind * start / math.tan(lowest) if start < 0 and lowest < 0 else 0.0
    profiles: list[Places] = []
    for c in range(num_columns):
        cells: dict[int, int] = {}
        for i in some:
            row = int((e[i] + math.pi / 2) / row_height)
            if column[i] == c and (row not in cells or z[i] < z[cells[row]]):
                cells[row] = i
        profile, last = [(0.0, start)], (first, start)
        for _, i in sorted(cells.items()):
            way = d[i] - last[0]
            if way > 0 and abs(z[i] - last[1]) <= step + slope * way:
                last = (d[i], z[i])
                profile.append(last)
        profiles.append(profile)

    def is_flat(c: int, at: tuple[float, float]) -> bool:
        around = [height_at(profiles[(c + side) % num_columns], at[0]) for side in range(-sides, sides + 1)]
        return at[1] - lower_median(around) <= bump

    smooth = [[at for at in profile if is_flat(c, at)] for c, profile in enumerate(profiles)]
    found = []
    for i in range(len(d)):
        before = math.floor(place[i] - 0.5)
        left, right = (height_at(smooth[(before + side) % num_columns], d[i]) for side in (0, 1))
        found.append(left + (place[i] - 0.5 - before) * (right - left))
    return torch.tensor(found, dtype=torch.float64)


def height_at(profile: Places, distance: float) -> float:
    """The height of a profile: linear between two places, constant beyond the last."""
    after = sum(at < distance for at, _ in profile)
    (d0, z0), (d1, z1) = profile[max(after - 1, 0)], profile[min(after, len(profile) - 1)]
    return z0 + (distance - d0) / (d1 - d0) * (z1 - z0) if d1 > d0 else z0


def lower_median(values: list[float]) -> float:
    return sorted(values)[(len(values) - 1) // 2]
