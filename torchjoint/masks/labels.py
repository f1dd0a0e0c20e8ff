"""Masks from a label map."""

from __future__ import annotations

from typing import Any

from torchjoint.masks.arrays import as_scores, as_tensor
from torchjoint.runtime.threads import on_cpu
from torchjoint.scene.masks import Masks


@on_cpu()
def from_labels(labels: Any, scores: Any = None, none: int = -1) -> Masks:
    """Masks that do not overlap.

    Args:
        labels: [H, W] integers, a mask for each value.
        scores: optional [M] in [0, 1], a score for each mask, in ascending order of the values; default 1.
        none: the value of pixels without a mask, -1 or 0.

    Raises:
        ValueError, TypeError: naming the argument, what was expected and what came.

    >>> import torch
    >>> from_labels(torch.tensor([[0, 0, 3], [0, 7, 7]]), none=0)
    Masks(2 masks, 2 x 3 pixels, 50% covered)
    """
    return Masks.from_labels(as_tensor(labels, "labels"), as_scores(scores, "scores"), none, "labels")
