"""Step 6, method learned: points without a colour, which files write as black or white."""

from __future__ import annotations

import torch
from torch import Tensor


def without_dropouts(colors: Tensor, edge_index: Tensor) -> Tensor:
    """Colours [N, 3], NaN for points that have none.

    A point has none if it is exactly black or white, and fewer than half of its neighbours are. So a black thing stays
    black.

    Args:
        colors: [N, 3] RGB in [0, 1], NaN = none.
        edge_index: [2, E] int64, edges of the point graph.
    """
    is_blank = (colors == 0).all(1) | (colors == 1).all(1)
    if not is_blank.any():
        return colors
    point, neighbor = torch.cat([edge_index, edge_index.flip(0)], 1)
    blank = torch.bincount(point[is_blank[neighbor]], minlength=len(colors))
    is_alone = is_blank & (2 * blank < torch.bincount(point, minlength=len(colors)))
    return colors.masked_fill(is_alone[:, None], torch.nan)
