"""match_pixels: the slow twin, and arguments that are right and wrong."""

from __future__ import annotations

from collections import deque
from typing import Any

import torch
from torch import Tensor

from reference.arguments import LABELS, NAN

EXAMPLE: dict[str, Any] = {"pred": LABELS > 0, "target": LABELS == 0, "radius": 1.5}
ERRORS = [
    ({"pred": LABELS}, TypeError, "pred: expected dtype torch.bool, got torch.int32"),
    ({"pred": LABELS[0] > 0}, ValueError, "pred: expected shape [H, W], got [4]"),
    ({"target": LABELS.T > 0}, ValueError, "target: expected shape [H, W] = [3, 4], got [4, 3]"),
    ({"radius": -1}, ValueError, "radius: expected a number >= 0, got -1"),
    ({"radius": torch.inf}, ValueError, "radius: expected a finite number >= 0, got inf"),
    ({"radius": "1"}, TypeError, "radius: expected int or float, got str"),
]
REFUSED = [
    {"pred": LABELS},
    {"target": LABELS.T > 0},
    {"radius": NAN},
]


def match_pixels_reference(pred: Tensor, target: Tensor, radius: float) -> tuple[Tensor, Tensor]:
    """What :func:`torchjoint.ops.match_pixels` computes, with dictionaries; the arguments are not checked.

    Example:
        >>> pred, target = torch.tensor([[True, True, False]]), torch.tensor([[True, False, True]])
        >>> match_pixels_reference(pred, target, radius=1)
        (tensor([[ True,  True, False]]), tensor([[ True, False,  True]]))
    """
    reach = int(min(radius, max(pred.shape, default=0)))
    square = [(r, c) for r in range(-reach, reach + 1) for c in range(-reach, reach + 1)]
    offsets = sorted((r * r + c * c, r, c) for r, c in square if r * r + c * c <= radius * radius)
    targets = {(r, c) for r, c in target.nonzero().tolist()}
    target_of: dict[tuple[int, int], tuple[int, int]] = {}
    pred_of: dict[tuple[int, int], tuple[int, int]] = {}

    def near(pixel: tuple[int, int]) -> list[tuple[int, int]]:
        return [there for _, r, c in offsets if (there := (pixel[0] + r, pixel[1] + c)) in targets]

    def augment(start: tuple[int, int]) -> None:
        reached_from: dict[tuple[int, int], tuple[int, int]] = {}
        queue = deque([start])
        while queue:
            pixel = queue.popleft()
            for there in near(pixel):
                if there in reached_from:
                    continue
                reached_from[there] = pixel
                if there in pred_of:
                    queue.append(pred_of[there])
                    continue
                end: tuple[int, int] | None = there
                while end is not None:
                    before = reached_from[end]
                    pred_of[end] = before
                    target_of[before], end = end, target_of.get(before)
                return

    preds = [(r, c) for r, c in pred.nonzero().tolist()]
    for _, r, c in offsets:
        for pixel in preds:
            there = (pixel[0] + r, pixel[1] + c)
            if pixel not in target_of and there in targets and there not in pred_of:
                target_of[pixel], pred_of[there] = there, pixel
    for pixel in preds:
        if pixel not in target_of:
            augment(pixel)

    pred_matched, target_matched = torch.zeros_like(pred), torch.zeros_like(target)
    for pixel, there in target_of.items():
        pred_matched[pixel] = target_matched[there] = True
    return pred_matched, target_matched
