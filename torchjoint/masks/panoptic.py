"""Masks from a label map and a list of its segments, as panoptic heads give them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import torch

from torchjoint.masks.arrays import as_tensor
from torchjoint.runtime.threads import on_cpu
from torchjoint.scene.checks import as_labels
from torchjoint.scene.masks import INT64, Masks


@on_cpu()
def from_panoptic(segmentation: Any, segments_info: Sequence[Mapping[str, Any]]) -> Masks:
    """Masks of Detectron2's `panoptic_seg`, and of Hugging Face's `post_process_*_segmentation`.

    Args:
        segmentation: [H, W] integers.
        segments_info: a dict for each mask: ``id``, the mask's value in the map, and an optional ``score`` in [0, 1].
            Pixels with other values are in no mask.

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
        if not isinstance(info, Mapping) or "id" not in info:
            raise ValueError(f"segments_info[{index}]: expected a dict with id, got {info!r}")
        ids.append(int(info["id"]))
        if not INT64.min <= ids[-1] <= INT64.max:
            raise ValueError(f"segments_info[{index}]: expected an id of 64 bits, got {str(ids[-1])[:60]}")
        masks.append(labels == ids[-1])
        scores.append(float(info.get("score", 1.0)))
    if len(set(ids)) < len(ids):
        raise ValueError(f"segments_info: expected each id once, got {sorted(ids)}")
    stack = torch.stack(masks) if masks else torch.zeros(0, *labels.shape, dtype=torch.bool)
    return replace(Masks.from_stack(stack, torch.tensor(scores), "segmentation"), ids=tuple(ids))
