"""Step 6, method scan: finds the ground of a LiDAR scan, from the sensor outward in each azimuth column.

M. Himmelsbach et al., "Fast Segmentation of 3D Point Clouds for Ground Vehicles" (IV 2010), fit lines to the lowest
points of the cells of a column. Here a height profile connects these lowest points, and neighbouring profiles are
compared.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torchjoint.ops.internal import ground_heights
from torchjoint.runtime.threads import all_threads, one_thread_per_operation
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
        return height - ground_below(seen, height, used)


def ground_below(seen: Directions, height: Tensor, used: Tensor | None = None) -> Tensor:
    """Heights [N] float64 of the ground at points: what :func:`height_over_ground` subtracts from their heights.

    Args:
        seen: directions of N points.
        height: [N] float64 metres above the sensor.
        used: [N] bool, the points that may be ground, at least one; None: all.
    """
    with all_threads():
        return ground_heights(
            *(seen.azimuth, seen.elevation, seen.distance, height),
            torch.ones(len(height), dtype=torch.bool) if used is None else used,
            num_columns=max(1, round(360 / AZIMUTH_CELL)),
            row_height=math.radians(ELEVATION_CELL),
            slope=math.tan(math.radians(MAX_SLOPE)),
            step=MAX_STEP,
            bump=MAX_BUMP,
            near=NEAR,
            blind=BLIND,
            sides=SIDES,
        )
