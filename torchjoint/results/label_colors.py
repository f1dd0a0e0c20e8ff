"""A colour for every label (output after step 8)."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

NONE_COLOR = 0.12


def label_colors(labels: Tensor, num_point_segments: int | None = None) -> Tensor:
    """A colour for each label; an id has the same colour in every picture and cloud.

    Args:
        labels: [...] int64, -1 = none (dark grey).
        num_point_segments: ids >= this number have no 3D segment and get pale colours; None: no pale colours.

    Returns:
        [..., 3] float32 RGB in [0, 1].
    """
    num_colors = max(int(labels.max()), -1) + 2 if labels.numel() else 0
    if labels.numel() > num_colors:  # an image: a table is faster
        return label_colors(torch.arange(-1, num_colors - 1), num_point_segments)[labels.clamp(min=-1) + 1]
    from matplotlib.colors import hsv_to_rgb

    ids = labels.clamp(min=0).double().numpy()
    # Hues advance by the golden ratio: consecutive ids get clearly different colours.
    hue = np.mod(0.07 + ids * 0.6180339887498949, 1.0)
    saturation = 0.45 + 0.5 * np.mod(ids * 0.7548776662466927, 1.0)
    value = 0.6 + 0.4 * np.mod(ids * 0.5698402909980532, 1.0)
    if num_point_segments is not None:
        pale = labels.numpy() >= num_point_segments
        saturation = np.where(pale, 0.15, saturation)
        value = np.where(pale, 0.35 + 0.3 * value, value)
    colors = torch.from_numpy(hsv_to_rgb(np.stack([hue, saturation, value], axis=-1))).float()
    return torch.where(labels[..., None] < 0, NONE_COLOR, colors)
