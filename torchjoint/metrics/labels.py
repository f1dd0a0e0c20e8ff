"""Checks labels for the metrics, and flattens them on the CPU."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

INTEGERS = (torch.uint8, torch.int8, torch.int16, torch.int32, torch.int64)


def checked_labels(labels: Tensor, name: str) -> Tensor:
    """Checks labels >= -1 of any shape; returns [N] int64.

    Raises:
        TypeError: not an integer tensor.
        ValueError: empty, or labels below -1.
    """
    got = labels.dtype if isinstance(labels, Tensor) else type(labels).__name__
    if got not in INTEGERS:
        raise TypeError(f"{name}: expected an integer tensor, got {got}")
    if labels.numel() == 0:
        raise ValueError(f"{name}: expected at least one label, got an empty tensor of shape {tuple(labels.shape)}")
    flat = labels.to("cpu", torch.int64).flatten()
    if int(flat.min()) < -1:
        raise ValueError(f"{name}: expected labels >= -1, got {int(flat.min())}")
    return flat


def checked_targets(target: Tensor | Sequence[Tensor]) -> dict[str, Tensor]:
    """Checks one or several ground truths of any shape; returns name in messages -> labels [N] int64.

    Raises:
        TypeError, ValueError: as :func:`checked_labels`; ValueError also for an empty sequence, or only void labels.
    """
    named = (
        {f"target[{i}]": one for i, one in enumerate(target)} if isinstance(target, Sequence) else {"target": target}
    )
    if not named:
        raise ValueError("target: expected at least one ground truth, got an empty sequence")
    flat = {name: checked_labels(one, name) for name, one in named.items()}
    for name, one in flat.items():
        if int(one.max()) < 0:
            raise ValueError(f"{name}: expected at least one label >= 0, got nothing but -1 (void)")
    return flat


def checked_pair(pred: Tensor, target: Tensor | Sequence[Tensor]) -> tuple[Tensor, list[Tensor]]:
    """Checks a prediction and its ground truths; returns each as [N] int64.

    Raises:
        TypeError, ValueError: as :func:`checked_targets`; ValueError also for shapes that differ.
    """
    flat = checked_labels(pred, "pred")
    targets = checked_targets(target)
    for name, one in zip(targets, target if isinstance(target, Sequence) else [target], strict=True):
        if one.shape != pred.shape:
            raise ValueError(f"{name}: expected the shape of pred, {tuple(pred.shape)}, got {tuple(one.shape)}")
    return flat, list(targets.values())
