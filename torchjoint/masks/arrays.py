"""Masks from arrays and label images."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchjoint.runtime.archives import as_int64
from torchjoint.runtime.threads import on_cpu
from torchjoint.scene.masks import Masks


def as_tensor(values: Any, name: str) -> Tensor:
    """Converts a tensor or a NumPy array to a tensor on the CPU without gradient.

    Raises:
        TypeError: neither of the two, or one that has no real numbers or booleans.
    """
    if isinstance(values, Tensor):
        is_dense = values.layout == torch.strided and not (values.is_nested or values.is_meta or values.is_quantized)
        if values.dtype.is_complex or not is_dense:
            raise TypeError(f"{name}: expected a dense tensor of real numbers, got {values.layout}, {values.dtype}")
        return values.detach().cpu()
    if not isinstance(values, np.ndarray) or isinstance(values, np.ma.MaskedArray):
        raise TypeError(f"{name}: expected a torch.Tensor or a NumPy array, got {type(values).__name__}")
    if values.dtype.kind not in "biuf":
        raise TypeError(f"{name}: expected numbers or booleans, got dtype {values.dtype}")
    return torch.from_numpy(np.array(as_int64(values, name)))


def as_binary(values: Any, name: str) -> Tensor:
    """Converts booleans, numbers 0 and 1, or uint8 numbers 0 and 255 to a bool tensor."""
    tensor = as_tensor(values, name)
    if tensor.dtype == torch.bool:
        return tensor
    inside = tensor != 0
    top = 255 if tensor.dtype == torch.uint8 and bool((tensor == 255).any()) else 1
    if not torch.equal(tensor, inside.to(tensor.dtype) * top):
        low, high = float(tensor.min()), float(tensor.max())
        told = f"{name}: expected booleans, or numbers 0 and 1, got {tensor.dtype} from {low:.4g} to {high:.4g}"
        raise ValueError(f"{told}; use `> 0` for logits, `> 0.5` for probabilities")
    return inside


def as_scores(scores: Any, name: str) -> Tensor | None:
    """Converts scores (a tensor, an array or a list of numbers) to a float tensor; None stays None."""
    if scores is None:
        return None
    if isinstance(scores, (list, tuple)):
        scores = np.array(scores, dtype=np.float64).reshape(len(scores))
    return as_tensor(scores, name).float()


@on_cpu()
def from_stack(stack: Any, scores: Any = None, names: Sequence[str] = ()) -> Masks:
    """Masks that may overlap and nest.

    Args:
        stack: [M, H, W] booleans, or numbers 0 and 1.
        scores: optional [M] in [0, 1]; default 1.
        names: M names, such as classes: those of most of its masks become a segment's name; default: none.

    Raises:
        ValueError, TypeError: naming the argument, what was expected and what came.

    >>> import torch
    >>> from_stack(torch.tensor([[[1, 1, 0]], [[1, 0, 0]]]), scores=[0.9, 0.8])
    Masks(2 masks, 1 x 3 pixels, 67% covered)
    """
    found = Masks.from_stack(as_binary(stack, "stack"), as_scores(scores, "scores"), "stack")
    if not all(isinstance(one, str) for one in names):  # a network's dict of all its classes
        raise TypeError(f"names: expected a string for each mask, got {str(names)[:60]}")
    return replace(found, names=tuple(names))


@on_cpu()
def from_labels(labels: Any, scores: Any = None, none: int | None = None) -> Masks:
    """Masks that do not overlap.

    Args:
        labels: [H, W] integers, a mask for each value.
        scores: optional [M] in [0, 1], a score for each mask, in ascending order of the values; default 1.
        none: the value of pixels without a mask; default: -1, and 0 if the labels have no sign (uint8, ...).

    Raises:
        ValueError, TypeError: naming the argument, what was expected and what came.

    >>> import torch
    >>> from_labels(torch.tensor([[0, 0, 3], [0, 7, 7]]), none=0)
    Masks(2 masks, 2 x 3 pixels, 50% covered)
    """
    found = as_tensor(labels, "labels")
    none = none if none is not None else 0 if "uint" in str(labels.dtype) else -1
    return Masks.from_labels(found, as_scores(scores, "scores"), none, "labels")
