"""Masks of a label image in COCO's run-length encoding, by pycocotools."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from torch import Tensor

from torchjoint.results.objects import image_views
from torchjoint.runtime.extras import needed_for


class Mask(NamedTuple):
    """The pixels of one segment in one image."""

    segment: int  #: its id
    box: list[int]  #: x, y, width, height
    area: int  #: pixels
    encoded: dict[str, Any]  #: {"size": [H, W], "counts": text}


def masks_of(labels: Tensor) -> Iterator[Mask]:
    """The masks of all segments of a label image [H, W], ascending by id; pixels without a label are in none.

    Raises:
        ModuleNotFoundError: pycocotools is not installed.
    """
    with needed_for("--format coco or sam", "pycocotools", "torchjoint[export]"):
        from pycocotools import mask as coder
    ids, place = labels.unique(return_inverse=True)  # small numbers: ids may be large
    for index, area, box in image_views(place, len(ids)):
        if int(ids[index]) >= 0:
            encoded = coder.encode(np.asfortranarray((place == index).numpy(), dtype=np.uint8))
            counts = encoded["counts"].decode("ascii")
            yield Mask(int(ids[index]), list(box), area, {"size": list(labels.shape), "counts": counts})
