"""Masks from what networks return: SAM, panoptic and instance segmentation."""

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import torch

from torchjoint.masks.arrays import as_binary, as_scores, as_tensor
from torchjoint.masks.segmentation import Pixels, check_declared, merged, pixels_in_box
from torchjoint.runtime.threads import on_cpu
from torchjoint.scene.checks import as_labels
from torchjoint.scene.masks import INT64, Masks


@on_cpu()
def from_sam(records: Sequence[Mapping[str, Any]], size: tuple[int, int] | None = None) -> Masks:
    """Masks of SAM, SAM 2 and their relatives: what `SamAutomaticMaskGenerator.generate(image)` returns.

    Args:
        records: a dict for each mask: ``segmentation`` (array [H, W], or COCO run lengths, compressed or not);
            optional ``predicted_iou``, ``stability_score`` and ``score``: their product, clipped to [0, 1], counts;
            optional ``area``, which must be the mask's number of pixels, ``bbox``, around it, and ``class_name``.
        size: (H, W) of the image; required if `records` may be empty.

    Raises:
        ValueError, TypeError: naming the record and its entry, what was expected and what came.

    >>> from_sam([{"segmentation": {"size": [2, 3], "counts": [1, 2, 3]}, "predicted_iou": 0.95}])
    Masks(1 masks, 2 x 3 pixels, 33% covered)
    """
    if isinstance(records, (Mapping, str)) or not isinstance(records, Sequence):
        raise TypeError(f"records: expected a list of dicts, got {type(records).__name__}")
    scores = torch.tensor([_score(one, f"records[{i}]") for i, one in enumerate(records)], dtype=torch.float32)
    check_declared((record["segmentation"] for record in records), size, "records")
    masks = (_pixels(record, size, f"records[{index}]") for index, record in enumerate(records))
    return replace(merged(masks, len(records), size, scores, "records"), names=_names(records))


def _pixels(record: Mapping[str, Any], size: tuple[int, int] | None, name: str) -> Pixels:
    own, pixels = pixels_in_box(record, size, f"{name}'s segmentation")
    area = record.get("area")
    if area is not None and area != len(pixels):
        raise ValueError(f"{name}'s area: expected the mask's {len(pixels)} pixels, got {area}")
    return own, pixels


def _score(record: Mapping[str, Any], name: str) -> float:
    if not isinstance(record, Mapping) or "segmentation" not in record:
        raise ValueError(f"{name}: expected a dict with segmentation, got {str(record)[:60]}")
    product = 1.0
    for entry in ("predicted_iou", "stability_score", "score"):
        value = record.get(entry, 1.0)
        value = value[0] if isinstance(value, list) and len(value) == 1 else value  # as Grounded SAM 2 writes it
        try:
            product *= float(value)
        except (TypeError, ValueError, OverflowError) as error:
            raise TypeError(f"{name}'s {entry}: expected a number, got {str(value)[:60]!r}") from error
        if not math.isfinite(float(value)):
            raise ValueError(f"{name}'s {entry}: expected a finite number, got {value}")
    return min(max(product, 0.0), 1.0)


def _names(records: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    names = tuple(str(record.get("class_name") or "") for record in records)
    return names if any(names) else ()


@on_cpu()
def from_panoptic(segmentation: Any, segments_info: Sequence[Mapping[str, Any]]) -> Masks:
    """Masks of Detectron2's `panoptic_seg`, and of Hugging Face's `post_process_*_segmentation`.

    Args:
        segmentation: [H, W] integers.
        segments_info: a dict for each mask: ``id``, the mask's value in the map, an optional ``score`` in [0, 1], and
            an optional ``class_name``. Pixels with other values are in no mask.

    Raises:
        ValueError, TypeError: naming the argument, what was expected and what came; also if an id occurs twice.

    >>> import torch
    >>> from_panoptic(torch.tensor([[0, 4, 4]]), [{"id": 4, "score": 0.9}])
    Masks(1 masks, 1 x 3 pixels, 67% covered)
    """
    found = as_tensor(segmentation, "segmentation")
    labels = as_labels(found, tuple(found.shape), "segmentation")
    masks, scores, ids = [], [], []
    for index, info in enumerate(segments_info):
        if not isinstance(info, Mapping) or not hasattr(info.get("id"), "__index__"):
            raise ValueError(f"segments_info[{index}]: expected a dict with id, an integer, got {str(info)[:60]}")
        ids.append(int(info["id"]))
        if not INT64.min <= ids[-1] <= INT64.max:
            raise ValueError(f"segments_info[{index}]: expected an id of 64 bits, got {str(ids[-1])[:60]}")
        masks.append(labels == ids[-1])
        scores.append(float(info.get("score", 1.0)))
    if len(set(ids)) < len(ids):
        raise ValueError(f"segments_info: expected each id once, got {sorted(ids)}")
    if lost := [one for one, mask in zip(ids, masks, strict=True) if not mask.any()]:
        warnings.warn(f"segmentation: {len(lost)} of {len(ids)} ids are not in it, such as {lost[0]}", stacklevel=3)
    stack = torch.stack(masks) if masks else torch.zeros(0, *labels.shape, dtype=torch.bool)
    made = Masks.from_stack(stack, torch.tensor(scores, dtype=torch.float32), "segmentation")
    return replace(made, ids=tuple(ids), names=_names(segments_info))


@on_cpu()
def from_instances(instances: Any, min_score: float = 0.0) -> Masks:
    """Masks of Detectron2's `Instances`: ``pred_masks`` [M, H, W] and ``scores`` [M], as attributes or as a dict.

    Args:
        instances: the instances, or a model's output with the entry ``instances``.
        min_score: masks with a lower score are left out. Query-based heads return all of their 100 or more queries.

    Raises:
        ValueError, TypeError: naming the entry, what was expected and what came.

    >>> import torch
    >>> from_instances({"pred_masks": torch.ones(2, 1, 3), "scores": torch.tensor([0.9, 0.1])}, min_score=0.5)
    Masks(1 masks, 1 x 3 pixels, 100% covered)
    """
    if not 0 <= min_score <= 1:
        raise ValueError(f"min_score: expected 0 to 1, got {min_score}")
    if isinstance(instances, dict) and "instances" in instances:
        instances = instances["instances"]
    found = [_entry(instances, name) for name in ("pred_masks", "scores")]
    if found[0] is None:
        raise TypeError(f"instances: expected pred_masks and scores, got {type(instances).__name__} without pred_masks")
    masks, scores = as_binary(found[0], "pred_masks"), as_scores(found[1], "scores")
    if scores is not None and min_score > 0 and scores.shape == masks.shape[:1]:
        kept = ~(scores < min_score)  # NaN stays, and is an error below
        masks, scores = masks[kept], scores[kept]
    return Masks.from_stack(masks, scores, "pred_masks")


def _entry(instances: Any, name: str) -> Any:
    return instances.get(name) if isinstance(instances, dict) else getattr(instances, name, None)
