"""Projects point labels into an image."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from torchjoint.views.visibility import Visible


def paint(visible: Visible, point_labels: Tensor, size: tuple[int, int]) -> Tensor:
    """Gives every pixel the label of the visible point that is nearest to it in the image.

    If several points project into one pixel, the point nearest to the camera counts (ties: the lower index).

    Args:
        visible: the points that the image's camera sees.
        point_labels: [N] int64, of all points.
        size: (H, W) of the image.

    Returns:
        [H, W] int64; all -1 if no point is visible.
    """
    from scipy.ndimage import distance_transform_edt

    image = torch.full((size[0] * size[1],), -1)
    if visible.point.numel() == 0:
        return image.view(size)
    pixel = visible.row * size[1] + visible.column
    far_first = (-visible.z.flip(0)).argsort(stable=True)  # of points at equal depth, the lower index comes last
    far_first = len(pixel) - 1 - far_first
    owner = torch.full_like(image, -1).numpy()
    owner[pixel[far_first].numpy()] = visible.point[far_first].numpy()  # the last write to a pixel stays
    nearest = distance_transform_edt(owner.reshape(size) < 0, return_distances=False, return_indices=True)
    return point_labels[torch.from_numpy(owner.reshape(size)[tuple(np.asarray(nearest))])]
