"""Step 6, method scan: finds the ground of a LiDAR scan, from the sensor outward in each azimuth column.

M. Himmelsbach et al., "Fast Segmentation of 3D Point Clouds for Ground Vehicles" (IV 2010), fit lines to the lowest
points of the cells of a column. Here a height profile connects these lowest points, and neighbouring profiles are
compared.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint.runtime.threads import one_thread_per_operation, parallel_map
from torchjoint.scene.checks import as_points
from torchjoint.segments.scan.directions import Directions, directions

#: Width of the azimuth columns along which the ground is followed, degrees: wide enough that few columns are empty
#: behind objects, narrow enough for streets that bend or bank.
AZIMUTH_CELL = 2.0

#: Height of the elevation cells of a column, degrees: about the angle between two beams of a 64-beam sensor. Each cell
#: contributes its lowest point.
ELEVATION_CELL = 0.4

#: Largest slope of the ground, degrees: streets are less steep, car bonnets and hedges are steeper.
MAX_SLOPE = 10.0

#: Allowed step in height in addition to the slope, metres: about twice the noise of the range.
MAX_STEP = 0.05

#: Parts of a profile more than this above the profiles beside it are not ground, metres. The value is larger than the
#: height of a kerb, and smaller than an object that fills a column from the sensor on, such as a car beside the sensor.
MAX_BUMP = 0.2

#: Points lower than this above the ground belong to it, metres: about the roughness of a road. A smaller value leaves
#: fragments of the road; a larger value adds feet of objects and kerbs to the ground.
GROUND_HEIGHT = 0.08

#: Horizontal distance from the sensor, metres, within which the sensor's height above the ground is estimated.
NEAR = 20.0

#: Number of columns on each side with which a profile is compared.
SIDES = 4

#: The blind distance, as a share of the distance at which the lowest beam meets level ground. Nearer points are not
#: ground. The share is less than 1, because the ground may rise.
BLIND = 0.75

#: Larger than any distance, metres: one sorted tensor holds all columns, one after the other, at offsets of FAR.
FAR = 1e5


class Profile(NamedTuple):
    """The ground's height at some places of C columns, sorted by column, then by distance (the first is 0)."""

    column: Tensor  #: [M] int64
    distance: Tensor  #: [M] float64 metres from the sensor, horizontal
    height: Tensor  #: [M] float64 metres above the sensor (negative below it)
    num_columns: int  #: C, of all 360 degrees

    def at(self, column: Tensor, distance: Tensor) -> Tensor:
        """Heights [...] at distances in columns: linear between two places, constant beyond the last.

        Args:
            column: [...] int64, any integer; taken modulo C.
            distance: [...] float64 metres.
        """
        column = column % self.num_columns
        after = torch.searchsorted(self.column * FAR + self.distance, column * FAR + distance.clamp(max=FAR / 2))
        below = torch.maximum(after - 1, torch.searchsorted(self.column, column))
        above = torch.minimum(after, torch.searchsorted(self.column, column, right=True) - 1)
        way = self.distance[above] - self.distance[below]
        share = (distance - self.distance[below]) / torch.where(way > 0, way, torch.inf)
        return self.height[below] + share * (self.height[above] - self.height[below])


def height_over_ground(points: Tensor, used: Tensor | None = None) -> Tensor:
    """Heights of the points of a scan above the ground.

    Each cell of azimuth and elevation contributes its lowest point. A profile follows each column of cells outward. It
    starts below the sensor, at the median height of the columns' lowest points near the sensor. It continues to the
    lowest point of a cell if this point is farther out than the profile so far and than the blind distance, and if the
    change of height is at most MAX_STEP plus MAX_SLOPE times the horizontal step. Parts of a profile more than MAX_BUMP
    above the median of the neighbouring profiles are removed, because there the profile follows an object that hides
    the ground. Between two places of a profile, and between two columns, the height is interpolated linearly.

    Args:
        points: [N, 3] metres, z up, the sensor at the origin.
        used: [N] bool, the points that may be ground, at least one; None: all.

    Returns:
        [N] float64 metres.

    Raises:
        ValueError, TypeError: naming the argument, what was expected and what came.
    """
    points = as_points(points)
    with torch.no_grad(), one_thread_per_operation():
        seen, height = directions(points), points[:, 2].double()
        some = slice(None) if used is None else torch.nonzero(used).flatten()
        profile = _without_bumps(ground_profile(Directions(*(values[some] for values in seen)), height[some]))
        place = _column_place(seen.azimuth, profile.num_columns) - 0.5  # a column's profile holds at its middle
        before = place.floor()
        left, right = parallel_map(lambda side: profile.at(before.long() + side, seen.distance), (0, 1))
        return height - (left + (place - before) * (right - left))


def ground_profile(seen: Directions, height: Tensor) -> Profile:
    """Follows each column outward, over the lowest points of its cells.

    Args:
        seen: directions of N points.
        height: [N] float64 metres above the sensor.

    Returns:
        one profile per column.
    """
    num_columns = max(1, round(360 / AZIMUTH_CELL))
    column = _column_place(seen.azimuth, num_columns).long().clamp(max=num_columns - 1)
    row = ((seen.elevation + math.pi / 2) / math.radians(ELEVATION_CELL)).long()
    row -= row.min()
    num_rows = int(row.max()) + 1
    lowest = _lowest(height, row * num_columns + column, num_rows * num_columns)
    exists = lowest < len(height)
    place = lowest.clamp(max=len(height) - 1)
    distances = seen.distance[place].view(num_rows, num_columns)
    heights = height[place].view(num_rows, num_columns)
    start = _start(seen.distance, height, column, num_columns)
    blind = _blind_distance(seen.elevation, start)
    taken = _walk(exists.view(num_rows, num_columns), distances, heights, start, blind)
    distances = torch.cat([torch.zeros_like(distances[:1]), distances])
    heights = torch.cat([torch.full_like(heights[:1], start), heights])
    taken = torch.cat([torch.ones_like(taken[:1]), taken])
    of_column, of_row = torch.nonzero(taken.T).unbind(1)
    return Profile(of_column, distances[of_row, of_column], heights[of_row, of_column], num_columns)


def _walk(exists: Tensor, distances: Tensor, heights: Tensor, start: float, blind: float) -> Tensor:
    """[R, C] bool, the cells whose lowest points belong to the profiles; each step handles one row of all columns."""
    slope = math.tan(math.radians(MAX_SLOPE))
    taken = torch.zeros_like(exists)
    distance, height = torch.full_like(distances[0], blind), torch.full_like(heights[0], start)
    for row in range(len(exists)):
        way = distances[row] - distance
        step = (heights[row] - height).abs()
        taken[row] = exists[row] & (way > 0) & (step <= MAX_STEP + slope * way)
        distance = torch.where(taken[row], distances[row], distance)
        height = torch.where(taken[row], heights[row], height)
    return taken


def _without_bumps(profile: Profile) -> Profile:
    """Removes the places that are more than MAX_BUMP above the median of the neighbouring profiles."""
    sides = torch.arange(-SIDES, SIDES + 1)[:, None]
    around = profile.at(profile.column + sides, profile.distance.expand(len(sides), -1))
    stays = profile.height - around.median(dim=0).values <= MAX_BUMP
    return profile._replace(
        column=profile.column[stays], distance=profile.distance[stays], height=profile.height[stays]
    )


def _column_place(azimuth: Tensor, num_columns: int) -> Tensor:
    """[N] float64 in [0, num_columns]: the column, and the position within it as the fraction."""
    return (azimuth + math.pi) / (2 * math.pi) * num_columns


def _lowest(height: Tensor, cell: Tensor, num_cells: int) -> Tensor:
    """[num_cells] int64, the lowest point of each cell (ties: the first point); N = none."""
    lowest = torch.full((num_cells,), torch.inf, dtype=height.dtype).scatter_reduce(0, cell, height, "amin")
    candidate = torch.where(height == lowest[cell], torch.arange(len(height)), len(height))
    return torch.full((num_cells,), len(height)).scatter_reduce(0, cell, candidate, "amin")


def _start(distance: Tensor, height: Tensor, column: Tensor, num_columns: int) -> float:
    """The ground's height below the sensor: the median of the lowest points of the columns near it, else of all."""
    near = distance <= max(NEAR, float(distance.min()))
    lowest = torch.full((num_columns,), torch.inf, dtype=height.dtype)
    lowest = lowest.scatter_reduce(0, column[near], height[near], "amin")
    return float(lowest[lowest < torch.inf].median())


def _blind_distance(elevation: Tensor, start: float) -> float:
    """The distance below which no point is ground, because the lowest beam meets the ground farther out; metres.

    Without it, the side of a car beside the sensor would be ground, from the lowest beam up.
    """
    lowest = float(elevation.kthvalue(1 + len(elevation) // 200).values)  # a few returns may come from below the ground
    return BLIND * start / math.tan(lowest) if start < 0 and lowest < 0 else 0.0
