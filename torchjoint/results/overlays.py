"""Labels blended over their image (output after step 8)."""

from __future__ import annotations

import torch
from torch import Tensor

from torchjoint.results.label_colors import label_colors


def overlay(image: Tensor, labels: Tensor, num_point_segments: int | None = None, opacity: float = 0.5) -> Tensor:
    """Blends the colours of labels over their image; borders between two labels are white.

    Args:
        image: [3, H, W] RGB in [0, 1].
        labels: [H, W] int64; pixels without a label (-1) show the image.
        num_point_segments: ids >= this number have no 3D segment and are pale; None: no pale colours.
        opacity: of the labels, 0 to 1.

    Returns:
        [3, H, W] float32 RGB in [0, 1].
    """
    table = label_colors(torch.arange(-1, int(labels.max()) + 1), num_point_segments)
    paint = table.T.contiguous()[:, labels + 1]
    blended = torch.where(labels < 0, image, image + (paint - image) * opacity)
    return torch.where(borders(labels), 1.0, blended)


def borders(labels: Tensor) -> Tensor:
    """Pixels whose right or lower neighbour has another label: [H, W] int64 -> [H, W] bool."""
    border = torch.zeros_like(labels, dtype=torch.bool)
    border[:, :-1] |= labels[:, :-1] != labels[:, 1:]
    border[:-1] |= labels[:-1] != labels[1:]
    return border
