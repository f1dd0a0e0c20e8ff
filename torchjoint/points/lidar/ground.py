"""The ground of a LiDAR scan: followed outward from the sensor, column by column.

M. Himmelsbach et al., "Fast Segmentation of 3D Point Clouds for Ground Vehicles" (IV 2010), fit lines to the lowest
points of such cells; here a profile goes from one to the next, and is compared with those beside it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint.config import ScanConfig
from torchjoint.points.lidar.directions import Directions, directions
from torchjoint.runtime.threads import one_thread_per_operation
from torchjoint.scene.checks import as_float, as_points, check_shape

#: Metres around the sensor in which its height over the ground is looked for.
NEAR = 20.0

#: Columns on each side that a profile is compared with.
SIDES = 4

#: More metres than any ground reaches: columns are laid end to end.
FAR = 1e5


class Profile(NamedTuple):
    """The ground's height at some places of each of C columns, by column, then by distance, from below the sensor."""

    column: Tensor  #: [M] int64
    distance: Tensor  #: [M] float64 metres from the sensor, on the level
    height: Tensor  #: [M] float64 metres over the sensor
    num_columns: int  #: C, all around

    def at(self, column: Tensor, distance: Tensor) -> Tensor:
        """The heights [...] at places in columns [...]: on a line between two places, level beyond the last."""
        column = column % self.num_columns
        after = torch.searchsorted(self.column * FAR + self.distance, column * FAR + distance.clamp(max=FAR / 2))
        below = torch.maximum(after - 1, torch.searchsorted(self.column, column))
        above = torch.minimum(after, torch.searchsorted(self.column, column, right=True) - 1)
        way = self.distance[above] - self.distance[below]
        share = (distance - self.distance[below]) / torch.where(way > 0, way, torch.inf)
        return self.height[below] + share * (self.height[above] - self.height[below])


def ground(points: Tensor, config: ScanConfig | None = None, sensor: Tensor | None = None) -> Tensor:
    """Which points of a scan lie on the ground: lower than `config.ground_height` over it.

    Args:
        points: [N, 3] metres, z up.
        config: see :class:`ScanConfig`.
        sensor: [3] metres, where the LiDAR stood; default: the origin.

    Returns:
        [N] bool.

    Raises:
        ValueError, TypeError: naming the argument, what was expected and what came.
    """
    config = config or ScanConfig()
    return height_over_ground(points, config, sensor) < config.ground_height


def height_over_ground(points: Tensor, config: ScanConfig | None = None, sensor: Tensor | None = None) -> Tensor:
    """How high the points of a scan are over the ground, [N] float64 metres; arguments are those of :func:`ground`.

    Cells of azimuth and elevation give their lowest points. Each column of cells is walked outward: it starts from the
    median of the columns' lowest points near the sensor, and goes on to the next lowest point if it is farther out and
    no steeper to reach than `max_slope` and a `max_step`. What of these profiles rises by more than `max_bump` over the
    median of those beside it is left out: the foot of something that hides the ground before it. Between two places of
    a profile, and between two columns, the ground is a straight line.
    """
    points = as_points(points)
    sensor = torch.zeros(3) if sensor is None else as_float(sensor, "sensor", torch.float64)
    check_shape(sensor, (3,), "sensor")
    config = config or ScanConfig()
    with torch.no_grad(), one_thread_per_operation():
        seen, height = directions(points, sensor), points[:, 2].double() - sensor[2]
        profile = _without_bumps(ground_profile(seen, height, config), config.max_bump)
        place = _column_place(seen.azimuth, profile.num_columns) - 0.5  # columns are known at their middles
        before = place.floor()
        left, right = (profile.at(before.long() + side, seen.distance) for side in (0, 1))
        return height - (left + (place - before) * (right - left))


def ground_profile(seen: Directions, height: Tensor, config: ScanConfig) -> Profile:
    """Walks outward along each column, over the lowest points of its cells.

    Args:
        seen: N points.
        height: [N] float64 metres over the sensor.
    """
    num_columns = max(1, round(360 / config.azimuth_cell))
    column = _column_place(seen.azimuth, num_columns).long().clamp(max=num_columns - 1)
    row = ((seen.elevation + math.pi / 2) / math.radians(config.elevation_cell)).long()
    row -= row.min()
    num_rows = int(row.max()) + 1
    lowest = _lowest(height, row * num_columns + column, num_rows * num_columns)
    exists = lowest < len(height)
    place = lowest.clamp(max=len(height) - 1)
    distances = seen.distance[place].view(num_rows, num_columns)
    heights = height[place].view(num_rows, num_columns)
    start = _start(seen.distance, height, column, num_columns)
    taken = _walk(exists.view(num_rows, num_columns), distances, heights, start, config)
    distances = torch.cat([torch.zeros_like(distances[:1]), distances])
    heights = torch.cat([torch.full_like(heights[:1], start), heights])
    taken = torch.cat([torch.ones_like(taken[:1]), taken])
    of_column, of_row = torch.nonzero(taken.T).unbind(1)
    return Profile(of_column, distances[of_row, of_column], heights[of_row, of_column], num_columns)


def _walk(exists: Tensor, distances: Tensor, heights: Tensor, start: float, config: ScanConfig) -> Tensor:
    """[R, C] bool, which cells' lowest points the walks go over; all columns take each step, a row, at once."""
    slope = math.tan(math.radians(config.max_slope))
    taken = torch.zeros_like(exists)
    distance, height = torch.zeros_like(distances[0]), torch.full_like(heights[0], start)
    for row in range(len(exists)):
        way = distances[row] - distance
        step = (heights[row] - height).abs()
        taken[row] = exists[row] & (way > 0) & (step <= config.max_step + slope * way)
        distance = torch.where(taken[row], distances[row], distance)
        height = torch.where(taken[row], heights[row], height)
    return taken


def _without_bumps(profile: Profile, max_bump: float) -> Profile:
    """What does not rise over the median of the profiles beside it."""
    sides = torch.arange(-SIDES, SIDES + 1)[:, None]
    around = profile.at(profile.column + sides, profile.distance.expand(len(sides), -1))
    stays = profile.height - around.median(dim=0).values <= max_bump
    return profile._replace(
        column=profile.column[stays], distance=profile.distance[stays], height=profile.height[stays]
    )


def _column_place(azimuth: Tensor, num_columns: int) -> Tensor:
    """[N] float64 in [0, num_columns]: the column, and where in it."""
    return (azimuth + math.pi) / (2 * math.pi) * num_columns


def _lowest(height: Tensor, cell: Tensor, num_cells: int) -> Tensor:
    """[num_cells] int64, the lowest point of each cell; ties: the first; N = none."""
    lowest = torch.full((num_cells,), torch.inf, dtype=height.dtype).scatter_reduce(0, cell, height, "amin")
    candidate = torch.where(height == lowest[cell], torch.arange(len(height)), len(height))
    return torch.full((num_cells,), len(height)).scatter_reduce(0, cell, candidate, "amin")


def _start(distance: Tensor, height: Tensor, column: Tensor, num_columns: int) -> float:
    """The ground's height below the sensor: the median of the lowest points of the columns near it, else of all."""
    near = distance <= max(NEAR, float(distance.min()))
    lowest = torch.full((num_columns,), torch.inf, dtype=height.dtype)
    lowest = lowest.scatter_reduce(0, column[near], height[near], "amin")
    return float(lowest[lowest < torch.inf].median())
