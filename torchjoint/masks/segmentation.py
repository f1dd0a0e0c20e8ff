"""One mask from any form in the records of SAM and COCO: array, run lengths, polygons."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchjoint.masks.arrays import as_binary
from torchjoint.masks.polygon import filled_polygon
from torchjoint.masks.rle import decode_rle


def mask_of(segmentation: Any, size: tuple[int, int] | None, name: str) -> Tensor:
    """The mask [H, W] bool.

    Args:
        segmentation: an array [H, W], run lengths (a dict), or polygons (a list of lists x, y, x, y, ...).
        size: (H, W) that the mask must have; None: any size. Polygons need it.
        name: name of the mask in messages.

    Raises:
        ValueError, TypeError: naming the segmentation, what was expected and what came.
    """
    if isinstance(segmentation, Mapping):
        mask = decode_rle(segmentation, name)
    elif isinstance(segmentation, (list, tuple)):
        if size is None:
            raise ValueError(f"{name}: polygons need the size (H, W) of the image")
        mask = _filled(segmentation, size, name)
    else:
        mask = as_binary(segmentation, name)
        if mask.ndim != 2:
            raise ValueError(f"{name}: expected shape [H, W], got {list(mask.shape)}")
    if size is not None and tuple(mask.shape) != tuple(size):
        raise ValueError(f"{name}: expected {size[0]} x {size[1]} pixels, got {mask.shape[0]} x {mask.shape[1]}")
    return mask


def _filled(polygons: Sequence[Any], size: tuple[int, int], name: str) -> Tensor:
    """The pixels whose centres lie in one of the polygons; COCO's pixel centres have coordinates that end with .5."""
    mask = np.zeros(size, dtype=bool)
    for polygon in polygons:
        try:
            corners = np.array(polygon, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise TypeError(f"{name}: expected polygons x, y, x, y, ... of numbers, got {polygon!r}") from error
        if corners.ndim != 1 or len(corners) < 6 or len(corners) % 2 or not np.isfinite(corners).all():
            raise ValueError(
                f"{name}: expected polygons x, y, x, y, ... of at least 3 finite corners, got {corners.shape} numbers"
            )
        mask |= filled_polygon(corners.reshape(-1, 2) - 0.5, size)
    return torch.from_numpy(mask)


def stacked(masks: Sequence[Tensor], size: tuple[int, int] | None, name: str) -> Tensor:
    """Stacks masks of one size to [M, H, W] bool.

    Raises:
        ValueError: the sizes differ; or there is no mask and no size.
    """
    if not masks:
        if size is None:
            raise ValueError(f"size: expected (H, W), because {name} has no masks")
        return torch.zeros(0, *size, dtype=torch.bool)
    for index, mask in enumerate(masks):
        if mask.shape != masks[0].shape:
            raise ValueError(f"{name}[{index}]: expected the size {list(masks[0].shape)}, got {list(mask.shape)}")
    return torch.stack(list(masks))
