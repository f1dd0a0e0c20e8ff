"""Step 6, method scan: the ground of a scan."""

import math

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from torchjoint.config import ScanConfig
from torchjoint.ops.internal import ground_heights, has_points_above
from torchjoint.runtime.threads import all_threads, num_threads
from torchjoint.segments.scan.gaps import Gaps
from torchjoint.segments.scan.recognition import Directions

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
HEIGHT_RADIUS = 20.0

#: Number of columns on each side with which a profile is compared.
SIDES = 4

#: The blind distance, as a share of the distance at which the lowest beam meets level ground. Nearer points are not
#: ground. The share is less than 1, because the ground may rise.
BLIND = 0.75


def ground_below(seen: Directions, height: Tensor, used: Tensor | None = None) -> Tensor:
    """Heights [N] float64 of the ground at points, metres above the sensor.

    Each cell of azimuth and elevation contributes its lowest point. A profile follows each column of cells outward. It
    starts below the sensor, at the median height of the columns' lowest points near the sensor. It continues to the
    lowest point of a cell if this point is farther out than the profile so far and than the blind distance, and if the
    change of height is at most MAX_STEP plus MAX_SLOPE times the horizontal step. Parts of a profile more than MAX_BUMP
    above the median of the neighbouring profiles are removed, because there the profile follows an object that hides
    the ground. Between two places of a profile, and between two columns, the height is interpolated linearly.

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
            near=HEIGHT_RADIUS,
            blind=BLIND,
            sides=SIDES,
        )


#: Largest horizontal distance from the ground to a patch that joins it: metres, and metres per metre of distance from
#: the sensor, because rings on the ground are farther apart far from the sensor. The larger of the two counts.
HOP, HOP_GROWTH = 2.0, 0.1

#: A patch joins the ground if at least this share of its points near the ground fits the ground.
FITTING_SHARE = 0.8

#: Largest number of rounds in which patches join the ground.
ROUNDS = 12

#: Width of a cell in azimuth, radians (1 degree). Its length is about this share of its distance from the sensor.
CELL = math.radians(1.0)

#: Metres. A point higher than this above another one hangs over it (tree crowns, signs) and does not rise from it.
OVERHANG = 2.5


def grow_ground(
    points: Tensor, height: Tensor, seen: Directions, gaps: Gaps, config: ScanConfig, used: Tensor | None = None
) -> Tensor:
    """Which points of a scan belong to the ground.

    1. Points lower than GROUND_HEIGHT above the profiles.
    2. Points lower than `object_height` above the profiles, if nothing rises from them.
    3. Patches: connected points from which nothing rises. A patch joins the ground if most of its points near the
       ground fit: their height differs from that of the nearest point of the ground by at most GROUND_HEIGHT plus
       MAX_SLOPE times the horizontal distance. This is repeated, because another patch may continue this one.

    Args:
        points: [N, 3] metres, z up.
        height: [N] float64 metres above the profiles.
        seen: directions of the points.
        gaps: which points are connected.
        config: object_height.
        used: [N] bool, the points that may rise from others; None: all.

    Returns:
        [N] bool, True for ground.
    """
    on_ground = height < GROUND_HEIGHT
    if config.object_height == 0:
        return on_ground
    standing = torch.nonzero(~on_ground).flatten()
    flat = standing[~rising(seen, points[:, 2].double(), standing, config.object_height, used)]
    on_ground[flat[height[flat] < config.object_height]] = True
    flat = flat[~on_ground[flat]]
    among = torch.zeros_like(on_ground)
    among[flat] = True
    patch = gaps.components(among)[flat].numpy()
    x, y, z = (column.double().numpy() for column in points.unbind(1))
    hop = (HOP_GROWTH * seen.distance).clamp(min=HOP).numpy()
    slope = math.tan(math.radians(MAX_SLOPE))
    left, new = flat.numpy(), torch.nonzero(on_ground).flatten().numpy()
    way, nearest = np.full(len(left), np.inf), np.zeros(len(left), dtype=np.int64)
    count = int(patch.max(initial=0)) + 1
    for _ in range(ROUNDS):
        if len(left) == 0 or len(new) == 0:
            break
        # Only ground that was added in the last round, so only its box, may be nearer than what was found before.
        some = np.flatnonzero(np.hypot(_beside(x[left], x[new]), _beside(y[left], y[new])) * (1 - 1e-9) < way)
        tree = cKDTree(np.stack([x[new], y[new]], axis=1), balanced_tree=False, compact_nodes=False)
        reach = float(hop[left].max()) * (1 + 1e-9)  # what is farther away is not near
        own = np.stack([x[left[some]], y[left[some]]], axis=1)
        found, which = tree.query(own, distance_upper_bound=reach, workers=num_threads())
        nearer = found < way[some]
        some = some[nearer]
        way[some], nearest[some] = found[nearer], new[which[nearer]]
        near, fits = way <= hop[left], np.abs(z[left] - z[nearest]) <= GROUND_HEIGHT + slope * way
        num_near = np.bincount(patch[near], minlength=count)
        joins = (num_near > 0) & (np.bincount(patch[near & fits], minlength=count) >= FITTING_SHARE * num_near)
        stays = ~joins[patch]
        new = left[~stays]
        on_ground[torch.from_numpy(new)] = True
        left, way, nearest, patch = left[stays], way[stays], nearest[stays], patch[stays]
    return on_ground


def _beside(values: NDArray[np.float64], others: NDArray[np.float64]) -> NDArray[np.float64]:
    """How far values are from the range of others."""
    return np.maximum(others.min() - values, values - others.max()).clip(min=0)


def rising(seen: Directions, height: Tensor, which: Tensor, object_height: float, used: Tensor | None = None) -> Tensor:
    """Whether something rises from points: whether a higher point lies in the same cell or in one of the 8 around it.

    The higher point must be more than `object_height` and less than `OVERHANG` above the point. The cells divide the
    plane by azimuth and by the logarithm of the horizontal distance.

    Args:
        seen: directions of N points.
        height: [N] float64 metres, above any reference.
        which: [M] int64, the points to test.
        object_height: metres.
        used: [N] bool, the points that may be the higher ones; None: all.

    Returns:
        [M] bool.
    """
    num_columns = round(2 * math.pi / CELL)
    column = ((seen.azimuth + math.pi) / (2 * math.pi) * num_columns).long() % num_columns
    row = (seen.distance.clamp(min=1e-3).log() / CELL).floor().long()
    row -= row.min()
    used = torch.ones_like(column, dtype=torch.bool) if used is None else used
    with all_threads():
        size = num_columns, int(row.max()) + 1
        return has_points_above(column, row, height, used, which, *size, object_height, OVERHANG)
