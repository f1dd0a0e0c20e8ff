"""Overlaps of two segmentations, and the segmentation covering."""

import warnings
from collections.abc import Sequence
from statistics import fmean
from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint.runtime.groups import numbers_by_first_place, renumber_by_value
from torchjoint.runtime.threads import on_cpu

INTEGERS = (torch.uint8, torch.int8, torch.int16, torch.int32, torch.int64)


def check_integers(values: object, told: str) -> None:
    """Raises TypeError, whose message begins with `told`, unless the values are a tensor of integers."""
    got: object = type(values).__name__
    if isinstance(values, Tensor):
        got = values.dtype if values.layout == torch.strided else values.layout
        got = "a nested or meta one" if values.is_nested or values.is_meta else got
    if got not in INTEGERS:
        raise TypeError(f"{told}, got {got}")


def checked_labels(labels: Tensor, name: str) -> Tensor:
    """Checks labels >= -1 of any shape; returns [N] int64.

    Raises:
        TypeError: not an integer tensor.
        ValueError: empty, or labels below -1.
    """
    check_integers(labels, f"{name}: expected an integer tensor")
    if labels.numel() == 0:
        raise ValueError(f"{name}: expected at least one label, got an empty tensor of shape {tuple(labels.shape)}")
    flat = labels.to("cpu", torch.int64).flatten()
    if int(flat.min()) < -1:
        raise ValueError(f"{name}: expected labels >= -1, got {int(flat.min())}")
    if labels.dtype == torch.uint8 and int(flat.max()) == 255:
        warnings.warn(f"{name}: 255 is a region; if it was void or none (-1), give integers with a sign", stacklevel=5)
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


class Overlaps:
    """The E pairs of a predicted and a true region that share points. Regions are numbered by first appearance."""

    def __init__(self, pred: Tensor, num_pred: int, target: Tensor) -> None:
        target, num_target = _by_first_appearance(target)
        key, self.count = count_keys(pred * num_target + target, num_pred * num_target)  # [E] shared points
        self.pred, self.target = key // num_target, key % num_target  # [E], ascending
        self.pred_area = torch.bincount(pred, minlength=num_pred)  # [P]; 0 where this ground truth is void
        self.target_area = torch.bincount(target)  # [T]
        iou = self.count.double() / (self.pred_area[self.pred] + self.target_area[self.target] - self.count)
        self.precision = self.count.double() / self.pred_area[self.pred]
        self.recall = self.count.double() / self.target_area[self.target]
        self.best_iou_of_pred = largest(iou, self.pred, num_pred)
        self.best_iou_of_target = largest(iou, self.target, num_target)


@on_cpu()
def overlap_tables(pred: Tensor, target: Tensor | Sequence[Tensor]) -> tuple[Tensor, list[Overlaps]]:
    """Returns the predicted regions' areas [P] and one table per ground truth, all with the same P."""
    pred, targets = checked_pair(pred, target)
    labelled = torch.stack([one >= 0 for one in targets]).any(0)
    regions, num_pred = _by_first_appearance(pred[labelled])
    inside = [one[labelled] >= 0 for one in targets]
    tables = [Overlaps(regions[i], num_pred, one[labelled][i]) for i, one in zip(inside, targets, strict=True)]
    return torch.bincount(regions), tables


def largest(value: Tensor, index: Tensor, size: int) -> Tensor:
    """Returns the largest value of each index, [size]; 0 for an index without values."""
    return value.new_zeros(size).scatter_reduce(0, index, value, "amax")


def count_keys(key: Tensor, size: int) -> tuple[Tensor, Tensor]:
    """Returns the distinct values of [N] keys in 0 ... size-1, ascending, and the count of each."""
    if size > 4 * len(key) + 1024:  # too sparse for direct indexing: sort instead
        return key.unique(return_counts=True)
    counts = torch.bincount(key, minlength=size)
    values = counts.nonzero().flatten()
    return values, counts[values]


def places(mask: Tensor) -> Tensor:
    """Returns the indices [M] int64 where [N] bool is True, by NumPy: several times faster than by torch."""
    return torch.from_numpy(mask.numpy().nonzero()[0])


def _by_first_appearance(labels: Tensor) -> tuple[Tensor, int]:
    """Renumbers labels [N] >= -1 to 0 ... R-1 in order of first appearance; returns also R."""
    labels = renumber_by_value(labels)[1] + 1
    number = numbers_by_first_place(labels, int(labels.max()) + 1)[labels]
    return number, int(number.max()) + 1


class SegmentationCovering(NamedTuple):
    """Coverings in [0, 1]: the mean of the next two; C(pred -> target), the usual one; and C(target -> pred)."""

    symmetric: float
    target_by_pred: float
    pred_by_target: float


def segmentation_covering(pred: Tensor, target: Tensor | Sequence[Tensor]) -> SegmentationCovering:
    """Computes the segmentation covering in both directions, and their mean.

    ``C(A -> B) = 1/n sum_{R in B} |R| max_{R' in A} IoU(R, R')``, averaged over the ground truths if there are several.
    P. Arbelaez et al., "Contour Detection and Hierarchical Image Segmentation" (PAMI 2011).

    Args:
        pred: int64, any shape.
        target: int64 of the same shape, -1 = void; or a sequence of such tensors.

    Raises:
        TypeError: labels that are not integer tensors.
        ValueError: shapes that differ, labels below -1, only void labels, empty tensors.

    >>> import torch
    >>> segmentation_covering(torch.tensor([0, 0, 1, 1]), torch.tensor([5, 5, 5, 5]))
    SegmentationCovering(symmetric=0.5, target_by_pred=0.5, pred_by_target=0.5)
    """
    return covering_of(overlap_tables(pred, target)[1])


def covering_of(tables: Sequence[Overlaps]) -> SegmentationCovering:
    """:func:`segmentation_covering` from existing tables, one per ground truth."""
    target_by_pred = fmean([_weighted_mean(t.best_iou_of_target, t.target_area) for t in tables])
    pred_by_target = fmean([_weighted_mean(t.best_iou_of_pred, t.pred_area) for t in tables])
    return SegmentationCovering((target_by_pred + pred_by_target) / 2, target_by_pred, pred_by_target)


def mean_best_iou(pred: Tensor, target: Tensor | Sequence[Tensor]) -> float:
    """Mean, over the ground-truth instances, of the best IoU with any predicted region.

    Unlike in the covering, every instance has the same weight. Arguments and errors: as
    :func:`segmentation_covering`.

    >>> import torch
    >>> mean_best_iou(torch.tensor([0, 0, 0, 1]), torch.tensor([0, 0, 1, 1]))  # 2/3 and 1/2
    0.5833333333333333
    """
    return best_iou_of(overlap_tables(pred, target)[1])


def best_iou_of(tables: Sequence[Overlaps]) -> float:
    """Returns :func:`mean_best_iou` from existing tables."""
    return fmean([table.best_iou_of_target.mean().item() for table in tables])


def _weighted_mean(value: Tensor, weight: Tensor) -> float:
    return ((value * weight).sum() / weight.sum()).item()
