"""Labels of points as a label image."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from torchjoint.views.visibility import Visible


def paint(visible: Visible, point_labels: Tensor, size: tuple[int, int]) -> Tensor:
    """Every pixel gets the label of the visible point nearest to it in the image.

    Where several points fall in one pixel, the nearest to the camera counts (then the lower number).

    Args:
        point_labels: [N] int64, of all points.
        size: (H, W) of the image.

    Returns:
        [H, W] int64; all -1 where no point is visible.
    """
    from scipy.ndimage import distance_transform_edt

    image = torch.full((size[0] * size[1],), -1)
    if visible.point.numel() == 0:
        return image.view(size)
    pixel = visible.row * size[1] + visible.column
    far_first = (-visible.z.flip(0)).argsort(stable=True)  # of equals the lower number comes last
    far_first = len(pixel) - 1 - far_first
    owner = torch.full_like(image, -1).numpy()
    owner[pixel[far_first].numpy()] = visible.point[far_first].numpy()  # the last one written stays
    nearest = distance_transform_edt(owner.reshape(size) < 0, return_distances=False, return_indices=True)
    return point_labels[torch.from_numpy(owner.reshape(size)[tuple(np.asarray(nearest))])]
