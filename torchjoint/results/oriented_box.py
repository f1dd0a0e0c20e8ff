"""An upright box around an object: its base is level and is rotated to have the least area (output after step 8)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


class OrientedBox(NamedTuple):
    """A box; its first two axes are level, and the third points up."""

    center: Array  #: [3] metres
    size: Array  #: [3] metres, along the three axes; of the two level sides, the longer one comes first
    axes: Array  #: [3, 3], one axis per row, unit length, right-handed


def oriented_box(points: Array, up: Array) -> OrientedBox:
    """Computes the box with the smallest base around points; its height is their extent along `up`.

    Args:
        points: [N, 3] metres, N >= 1.
        up: [3] unit length.

    Example:
        >>> points = np.array([[0.0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0], [0, 0, 3]])
        >>> box = oriented_box(points, np.array([0.0, 0.0, 1.0]))
        >>> box.center.tolist(), box.size.tolist()
        ([1.0, 0.5, 1.5], [2.0, 1.0, 3.0])
    """
    import cv2

    level = level_axes(up)
    origin = points.mean(0)
    footprint = (points - origin) @ level.T
    corners = cv2.boxPoints(cv2.minAreaRect(footprint.astype(np.float32))).astype(np.float64)
    sides = corners[1:3] - corners[:2]
    side = sides[int(np.argmax(np.linalg.norm(sides, axis=1)))]
    length = float(np.linalg.norm(side))
    first = (side / length) @ level if length > 1e-9 else level[0]
    if first[np.argmax(np.abs(first))] < 0:  # the largest component shall be positive
        first = -first
    axes = np.stack([first, np.cross(up, first), up])
    along = (points - origin) @ axes.T
    low, high = along.min(0), along.max(0)
    return OrientedBox(origin + (low + high) / 2 @ axes, high - low, axes)


def level_axes(up: Array) -> Array:
    """Two unit vectors [2, 3] that are perpendicular to `up` and to each other."""
    across = np.eye(3)[int(np.argmin(np.abs(up)))]
    first = across - up * (across @ up)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(up, first)])
