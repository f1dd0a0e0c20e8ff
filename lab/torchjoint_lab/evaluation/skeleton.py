"""Thins binary masks to lines one pixel wide."""

from __future__ import annotations

import torch
from torch import Tensor


def thin(mask: Tensor) -> Tensor:
    """Thins a mask to its middle lines: [H, W] bool -> [H, W] bool, one pixel wide, with the mask's connectivity.

    Z. Guo and R. W. Hall, "Parallel thinning with two-subiteration algorithms" (CACM 1989), by OpenCV. Zhang's and
    Suen's algorithm would delete squares of two by two pixels and leave staircases; this algorithm does not.
    """
    import cv2

    # OpenCV does not change the outermost pixels, so the mask is padded.
    padded = torch.nn.functional.pad(mask.to(torch.uint8) * 255, (1, 1, 1, 1)).numpy()
    lines = cv2.ximgproc.thinning(padded, thinningType=cv2.ximgproc.THINNING_GUOHALL)
    return torch.from_numpy(lines)[1:-1, 1:-1] != 0
