"""Brightens images and clouds that a dim light made dark: steps of colour are then as large as in other data."""

from __future__ import annotations

import torch
from torch import Tensor

#: Least mean of colours. The data that the model was trained on have 0.3 to 0.55.
LEAST_MEAN = 0.3


def brightened(colors: Tensor) -> Tensor:
    """Scales colours so that their mean is at least LEAST_MEAN; what becomes brighter than 1 is 1.

    Zeros and NaNs do not count: they are mostly pixels and points without a colour.

    Args:
        colors: RGB in [0, 1], of any shape.
    """
    if float(colors.mean()) >= LEAST_MEAN:  # the usual case, for which copies would take time
        return colors
    known = torch.nan_to_num(colors)
    total, count = float(known.double().sum()), int(torch.count_nonzero(known))
    if total >= LEAST_MEAN * count:
        return colors
    return (colors * (LEAST_MEAN * count / total)).clamp(max=1)
