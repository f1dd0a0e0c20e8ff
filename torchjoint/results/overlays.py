"""Labels blended over their image (output after step 8)."""

from __future__ import annotations

import torch
from torch import Tensor

from torchjoint.results.label_colors import label_colors


def overlay(image: Tensor, labels: Tensor, num_point_segments: int | None = None) -> Tensor:
    """Blends the colours of labels over their image, half and half; borders between two labels are white.

    Args:
        image: [H, W, 3] uint8 RGB.
        labels: [H, W] int64; pixels without a label (-1) show the image.
        num_point_segments: ids >= this number have no 3D segment and are pale; None: no pale colours.

    Returns:
        [H, W, 3] uint8 RGB.
    """
    # Four bytes are one number, which is fast to look up.
    table = torch.zeros(int(labels.max()) + 2, 4, dtype=torch.uint8)
    table[:, :3] = (255 * label_colors(torch.arange(-1, len(table) - 1), num_point_segments)).round()
    paint = table.view(torch.int32).take(labels + 1).view(torch.uint8).view(*labels.shape, 4)[..., :3]
    blended = ((image.short() + paint) >> 1).to(torch.uint8)
    # NumPy sets some pixels of an image faster than torch.
    none, border, pixels = (labels < 0).numpy(), borders(labels).numpy(), blended.numpy()
    pixels[none] = image.numpy()[none]
    pixels[border] = 255
    return blended


def borders(labels: Tensor) -> Tensor:
    """Pixels whose right or lower neighbour has another label: [H, W] int64 -> [H, W] bool."""
    border = torch.zeros_like(labels, dtype=torch.bool)
    border[:, :-1] |= labels[:, :-1] != labels[:, 1:]
    border[:-1] |= labels[:-1] != labels[1:]
    return border
