"""Masks from the instances of Detectron2 and of networks built on it, such as Mask2Former and CropFormer."""

from __future__ import annotations

from typing import Any

from torchjoint.masks.arrays import as_binary, as_scores
from torchjoint.runtime.threads import on_cpu
from torchjoint.scene.masks import Masks


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
