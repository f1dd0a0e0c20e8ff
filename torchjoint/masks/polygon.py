"""The pixels of a polygon."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt


def filled_polygon(corners: npt.NDArray[np.float64], size: tuple[int, int]) -> npt.NDArray[np.bool_]:
    """The pixels whose centres lie in a polygon, or on its edge.

    A pixel is inside if a ray from it crosses an odd number of edges. Edges may cross each other.

    Args:
        corners: [C, 2] finite (x, y), pixels; integers are the centres of pixels.
        size: (H, W) of the image.

    Returns:
        [H, W] bool.
    """
    height, width = size
    crossed = np.zeros((height, width + 1), dtype=np.int64)
    on_edge = np.zeros(size, dtype=bool)
    for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        low, high = (y0, y1) if y0 <= y1 else (y1, y0)
        row = np.arange(max(int(np.ceil(low)), 0), min(int(np.floor(high)), height - 1) + 1)
        if y0 == y1:
            on_edge[row, max(int(np.ceil(min(x0, x1))), 0) : max(int(np.floor(max(x0, x1))) + 1, 0)] = True
            continue
        x = x0 + (row - y0) * ((x1 - x0) / (y1 - y0))
        column = np.round(x)
        exact = ((column - x0) * (y1 - y0) == (row - y0) * (x1 - x0)) & (column >= 0) & (column < width)
        on_edge[row[exact], column[exact].astype(np.int64)] = True
        # A row through a corner belongs to the edge below it alone; pixels to the right of the edge change sides.
        counts = row < high
        crossed[row[counts], np.clip(np.ceil(x[counts]), 0, width).astype(np.int64)] += 1
    inside = np.cumsum(crossed[:, :width], axis=1) % 2 == 1
    return inside | on_edge
