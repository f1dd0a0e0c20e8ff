"""Of the points that fall in one cell of an image, the nearest to the camera."""

from __future__ import annotations

import torch
from torch import Tensor

from torchjoint.runtime.sorted_groups import starts_group


def nearest_in_cells(cell: Tensor, z: Tensor) -> Tensor:
    """For each cell that is not empty its nearest point; of equally near ones the first.

    Args:
        cell: [M] int64, the cell of each point.
        z: [M], metres along the optical axis.

    Returns:
        [C] int64 places in the arguments, in ascending order of the cells.
    """
    order = torch.argsort(z, stable=True)
    order = order[torch.argsort(cell[order], stable=True)]
    return order[starts_group(cell[order])]
