"""Masks from a stack of binary images."""

from __future__ import annotations

from typing import Any

from torchjoint.masks.arrays import as_binary, as_scores
from torchjoint.runtime.threads import on_cpu
from torchjoint.scene.masks import Masks


@on_cpu()
def from_stack(stack: Any, scores: Any = None) -> Masks:
    """Masks that may overlap and nest.

    Args:
        stack: [M, H, W] booleans, or numbers 0 and 1.
        scores: optional [M] in [0, 1]; default 1.

    Raises:
        ValueError, TypeError: naming the argument, what was expected and what came.

    >>> import torch
    >>> from_stack(torch.tensor([[[1, 1, 0]], [[1, 0, 0]]]), scores=[0.9, 0.8])
    Masks(2 masks, 1 x 3 pixels, 67% covered)
    """
    return Masks.from_stack(as_binary(stack, "stack"), as_scores(scores, "scores"), "stack")
