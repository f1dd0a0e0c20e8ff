"""Steps 6-8: finds the point nearest to the camera in each cell of an image."""

from __future__ import annotations

import torch
from torch import Tensor

from torchjoint.runtime.sorted_groups import starts_group


def nearest_in_cells(cell: Tensor, z: Tensor) -> Tensor:
    """The nearest point of each non-empty cell; of equally near points the first.

    Args:
        cell: [M] int64, the cell of each point.
        z: [M] metres along the optical axis.

    Returns:
        [C] int64 indices into the arguments, one per cell, in ascending order of the cells.
    """
    order = torch.argsort(z, stable=True)
    order = order[torch.argsort(cell[order], stable=True)]
    return order[starts_group(cell[order])]
