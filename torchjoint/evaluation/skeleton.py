"""Skeletons of binary maps: lines one pixel wide."""

from __future__ import annotations

import torch
from torch import Tensor


def thin(mask: Tensor) -> Tensor:
    """The lines in the middle of a mask: [H, W] bool -> [H, W] bool, one pixel wide, connected as the mask is.

    Z. Guo and R. W. Hall, "Parallel thinning with two-subiteration algorithms" (CACM 1989), by OpenCV. Unlike Zhang's
    and Suen's algorithm it leaves something of squares of two by two, and no staircases.
    """
    import cv2

    # OpenCV leaves the outermost pixels as they are, so these must not be the image's.
    padded = torch.nn.functional.pad(mask.to(torch.uint8) * 255, (1, 1, 1, 1)).numpy()
    lines = cv2.ximgproc.thinning(padded, thinningType=cv2.ximgproc.THINNING_GUOHALL)
    return torch.from_numpy(lines)[1:-1, 1:-1] != 0
