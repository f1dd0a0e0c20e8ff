"""Masks from the lists of dicts that SAM's automatic mask generators give."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import torch

from torchjoint.masks.segmentation import Pixels, check_declared, merged, pixels_of
from torchjoint.runtime.threads import on_cpu
from torchjoint.scene.masks import Masks


@on_cpu()
def from_sam(records: Sequence[Mapping[str, Any]], size: tuple[int, int] | None = None) -> Masks:
    """Masks of SAM, SAM 2 and their relatives: what `SamAutomaticMaskGenerator.generate(image)` returns.

    Args:
        records: a dict for each mask: ``segmentation`` (array [H, W], or COCO run lengths, compressed or not);
            optional ``predicted_iou`` and ``stability_score``, whose product, clipped to [0, 1], is the score; optional
            ``area``, which must be the mask's number of pixels.
        size: (H, W) of the image; required if `records` may be empty.

    Raises:
        ValueError, TypeError: naming the record and its entry, what was expected and what came.

    >>> from_sam([{"segmentation": {"size": [2, 3], "counts": [1, 2, 3]}, "predicted_iou": 0.95}])
    Masks(1 masks, 2 x 3 pixels, 33% covered)
    """
    if isinstance(records, (Mapping, str)) or not isinstance(records, Sequence):
        raise TypeError(f"records: expected a list of dicts, got {type(records).__name__}")
    names = [f"records[{index}]" for index in range(len(records))]
    scores = torch.tensor([_score(record, name) for record, name in zip(records, names, strict=True)])
    check_declared((record["segmentation"] for record in records), size, "records")
    masks = (_pixels(record, size, name) for record, name in zip(records, names, strict=True))
    return merged(masks, len(records), size, scores, "records")


def _pixels(record: Mapping[str, Any], size: tuple[int, int] | None, name: str) -> Pixels:
    own, pixels = pixels_of(record["segmentation"], size, f"{name}'s segmentation")
    area = record.get("area")
    if area is not None and area != len(pixels):
        raise ValueError(f"{name}'s area: expected the mask's {len(pixels)} pixels, got {area}")
    return own, pixels


def _score(record: Mapping[str, Any], name: str) -> float:
    if not isinstance(record, Mapping) or "segmentation" not in record:
        raise ValueError(f"{name}: expected a dict with segmentation, got {_entries(record)}")
    product = 1.0
    for entry in ("predicted_iou", "stability_score"):
        value = record.get(entry, 1.0)
        try:
            product *= float(value)
        except (TypeError, ValueError, OverflowError) as error:
            raise TypeError(f"{name}'s {entry}: expected a number, got {str(value)[:60]!r}") from error
        if not math.isfinite(float(value)):
            raise ValueError(f"{name}'s {entry}: expected a finite number, got {value}")
    return min(max(product, 0.0), 1.0)


def _entries(record: object) -> str:
    return ", ".join(map(str, record)) or "an empty one" if isinstance(record, Mapping) else type(record).__name__
