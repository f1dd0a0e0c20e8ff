"""Finds the point of the cloud that the user clicked."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.floating]
#: A point can be hit within this angle from the ray (tangent): about three pixels.
ANGLE = 0.005


def pick_point(points: Array, origin: Array, direction: Array, radius: float) -> int | None:
    """Returns the index of the first point along a ray; None if there is none.

    Args:
        points: [N, 3].
        origin, direction: [3] of the ray.
        radius: a point at most this far from the ray is hit at any depth: half the spacing of the points.
    """
    direction = direction / np.linalg.norm(direction)
    offset = points - origin
    along = offset @ direction
    across = np.sqrt(np.maximum((offset * offset).sum(1) - along * along, 0))
    near = np.nonzero((along > 0) & (across < np.maximum(ANGLE * along, radius)))[0]
    if not len(near):
        return None
    front = along[near].min()
    first = near[along[near] <= front + 4 * radius]  # of the surface in front, the point closest to the ray
    return int(first[np.argmin(across[first])])
