"""How good a class-agnostic segmentation is: pure functions of label tensors.

Everything is computed from one table: how many points each predicted region shares with each true one.

Convention: labels are integers >= -1 of one shape, whatever that shape is (points [N], an image [H, W], a stack of
images). -1 in ``target`` is void: dropped before anything is counted. -1 in ``pred`` is "unlabelled": all of it
together is one background region. Which number a region has never matters. ``target`` may be a sequence of several
ground truths of the same data, such as several annotators'.

The measures: J. Pont-Tuset and F. Marques, "Supervised Evaluation of Image Segmentation and Object Proposal
Techniques" (PAMI 2016). A data set's value is the mean of its samples' values, F included.
"""

from __future__ import annotations

from collections.abc import Sequence
from statistics import fmean
from typing import NamedTuple

import torch
from torch import Tensor

#: Regions are candidates from the largest down until they hold this share of the data; the rest is too small to count.
CANDIDATE_SHARE = 0.99

_NONE, _PART, _OBJECT = 0, 1, 2


class SegmentationCovering(NamedTuple):
    """Coverings in [0, 1]: their mean, C(pred -> target) over the true regions (the usual one), C(target -> pred)."""

    symmetric: float
    target_by_pred: float
    pred_by_target: float


class ObjectsAndParts(NamedTuple):
    """Precision and recall for objects and parts, in [0, 1], and their harmonic mean (0 if both are 0)."""

    precision: float
    recall: float
    f: float


def segmentation_covering(pred: Tensor, target: Tensor | Sequence[Tensor]) -> SegmentationCovering:
    """Segmentation covering, both ways, and its symmetric mean.

    ``C(A -> B) = 1/n sum_{R in B} |R| max_{R' in A} IoU(R, R')``, averaged over the ground truths if several.

    Args:
        pred: int64, any shape.
        target: int64 of the same shape, -1 = void; or a sequence of such.

    Raises:
        TypeError: labels that are not integer tensors.
        ValueError: shapes that differ, labels below -1, nothing but void, nothing at all.

    >>> segmentation_covering(torch.tensor([0, 0, 1, 1]), torch.tensor([5, 5, 5, 5]))
    SegmentationCovering(symmetric=0.5, target_by_pred=0.5, pred_by_target=0.5)
    """
    _, tables = _tables(pred, target)
    target_by_pred = fmean([_weighted_mean(t.best_iou_of_target, t.target_area) for t in tables])
    pred_by_target = fmean([_weighted_mean(t.best_iou_of_pred, t.pred_area) for t in tables])
    return SegmentationCovering((target_by_pred + pred_by_target) / 2, target_by_pred, pred_by_target)


def mean_best_iou(pred: Tensor, target: Tensor | Sequence[Tensor]) -> float:
    """Mean, over the true instances, of the best IoU that any predicted region has with it.

    Unlike the covering, every instance counts the same, however small. Arguments and errors are those of
    :func:`segmentation_covering`.

    >>> mean_best_iou(torch.tensor([0, 0, 0, 1]), torch.tensor([0, 0, 1, 1]))  # 2/3 and 1/2
    0.5833333333333333
    """
    return fmean([t.best_iou_of_target.mean().item() for t in _tables(pred, target)[1]])


def objects_and_parts(
    pred: Tensor,
    target: Tensor | Sequence[Tensor],
    gamma_object: float = 0.75,
    gamma_part: float = 0.25,
    beta: float = 0.1,
) -> ObjectsAndParts:
    """Precision and recall for objects and parts.

    A predicted and a true region that overlap by ``gamma_object`` of both are objects. One that lies within the other
    by ``gamma_object`` and fills ``gamma_part`` of it is a part, worth ``beta`` of an object. What is neither still
    earns its fragmentation: the share of it that regions lying within it fill.

    With several ground truths recall runs over the regions of all of them, a predicted region is an object if it is one
    for any of them, and its fragmentation is their mean. The predicted candidates are chosen among the points
    that some ground truth labels.

    Args:
        pred: int64, any shape.
        target: int64 of the same shape, -1 = void; or a sequence of such.
        gamma_object: least overlap of an object. At 0.5 and below a true region may match several predicted ones as
            an object or as a part; the one seen last (in row-major order of first appearance) then decides.
        gamma_part: least overlap of a part, 0 < gamma_part <= gamma_object <= 1.
        beta: the worth of a part, in [0, 1].

    Raises:
        TypeError, ValueError: as :func:`segmentation_covering`; ValueError also for thresholds out of range.

    >>> objects_and_parts(torch.tensor([0, 0, 1, 1]), torch.tensor([5, 5, 5, 5]))  # two parts of one object
    ObjectsAndParts(precision=0.1, recall=1.0, f=0.18181818181818182)
    """
    return _objects_and_parts(*_tables(pred, target), gamma_object, gamma_part, beta)


def average_precision_objects(
    pred: Tensor, target: Tensor | Sequence[Tensor], gamma_part: float = 0.25, beta: float = 0.1
) -> float:
    """AP_o: :func:`objects_and_parts` with ``gamma_object`` = .50, .55, ... .95, integrated.

    The paper does not say how; here the points are taken by rising recall and the step sum
    ``sum (Re_i - Re_{i-1}) Pr_i`` is made, from Re_0 = 0, for each sample by itself.
    """
    tables = _tables(pred, target)
    return _step_sum([_objects_and_parts(*tables, k / 20, gamma_part, beta) for k in range(10, 20)])


def average_precision_parts(
    pred: Tensor, target: Tensor | Sequence[Tensor], gamma_object: float = 0.75, beta: float = 0.1
) -> float:
    """AP_p: as :func:`average_precision_objects`, but with ``gamma_part`` = .05, .10, ... .70."""
    tables = _tables(pred, target)
    return _step_sum([_objects_and_parts(*tables, gamma_object, k / 20, beta) for k in range(1, 15)])


class _Overlaps:
    """The pairs of a predicted and a true region that share points. Regions are numbered by first appearance."""

    def __init__(self, pred: Tensor, num_pred: int, target: Tensor) -> None:
        target, num_target = _by_first_appearance(target)
        key, count = _count(pred * num_target + target, num_pred * num_target)
        self.pred, self.target = key // num_target, key % num_target  # [E], ascending
        self.pred_area = torch.bincount(pred, minlength=num_pred)  # [P]; 0 where this ground truth is void
        self.target_area = torch.bincount(target)  # [T]
        areas = self.pred_area[self.pred] + self.target_area[self.target]
        iou = count.double() / (areas - count)
        self.precision = count.double() / self.pred_area[self.pred]
        self.recall = count.double() / self.target_area[self.target]
        self.best_iou_of_pred = _largest(iou, self.pred, num_pred)
        self.best_iou_of_target = _largest(iou, self.target, num_target)


def _tables(pred: Tensor, target: Tensor | Sequence[Tensor]) -> tuple[Tensor, list[_Overlaps]]:
    """Checked labels as the predicted regions' areas [P] and one table per ground truth, all with the same P."""
    pred, targets = _checked(pred, target)
    labelled = torch.stack([one >= 0 for one in targets]).any(0)
    regions, num_pred = _by_first_appearance(pred[labelled])
    inside = [one[labelled] >= 0 for one in targets]
    tables = [_Overlaps(regions[i], num_pred, one[labelled][i]) for i, one in zip(inside, targets, strict=True)]
    return torch.bincount(regions), tables


def _objects_and_parts(
    pred_area: Tensor, tables: list[_Overlaps], gamma_object: float, gamma_part: float, beta: float
) -> ObjectsAndParts:
    _check_thresholds(gamma_object, gamma_part, beta)
    pred_candidate = _candidates(pred_area)
    pred_class = torch.full_like(pred_area, _NONE)
    pred_fragments = torch.zeros(len(pred_class), dtype=torch.float64)
    recalled, expected = 0.0, 0
    for table in tables:
        target_candidate = _candidates(table.target_area)
        eligible = pred_candidate[table.pred] & target_candidate[table.target]
        fills, within = table.recall >= gamma_object, table.precision >= gamma_object
        is_object = eligible & fills & within
        pred_is_part = eligible & within & ~fills & (table.recall >= gamma_part)
        target_is_part = eligible & fills & ~within & (table.precision >= gamma_part)

        # Of a predicted region's matches the best counts (object before part), over all ground truths ...
        found = is_object * _OBJECT + pred_is_part * _PART
        pred_class = torch.maximum(pred_class, _largest(found, table.pred, len(pred_class)))
        # ... of a true region's, the last: the measure's own asymmetry, seen only where gamma_object <= 0.5.
        found = is_object * _OBJECT + target_is_part * _PART
        ranked = torch.where(found > _NONE, table.pred * 3 + found, 0)
        target_class = _largest(ranked, table.target, len(table.target_area)) % 3

        fragments = torch.bincount(table.pred, table.precision * (fills & ~within), len(pred_class))
        pred_fragments += fragments / len(tables)
        fragments = torch.bincount(table.target, table.recall * (within & ~fills), len(target_class))
        recalled += _worth(target_class, fragments, target_candidate, beta)
        expected += int(target_candidate.sum())
    precision = _worth(pred_class, pred_fragments, pred_candidate, beta) / int(pred_candidate.sum())
    recall = recalled / expected
    f = 2 * precision * recall / (precision + recall) if precision + recall > 0 else 0.0
    return ObjectsAndParts(precision, recall, f)


def _candidates(area: Tensor) -> Tensor:
    """[R] bool: the largest regions, up to and with the one that reaches the share. Ties: the later one first."""
    order = area.flip(0).argsort(descending=True, stable=True)
    share = (area.flip(0)[order].double() / area.sum()).cumsum(0)
    before = torch.cat([share.new_zeros(1), share[:-1]])
    candidate = torch.zeros_like(area, dtype=torch.bool)
    candidate[len(area) - 1 - order] = before < CANDIDATE_SHARE
    return candidate


def _worth(found: Tensor, fragments: Tensor, candidate: Tensor, beta: float) -> float:
    objects, parts = int((found == _OBJECT).sum()), int((found == _PART).sum())
    return objects + beta * parts + fragments[candidate & (found == _NONE)].sum().item()


def _by_first_appearance(labels: Tensor) -> tuple[Tensor, int]:
    """Labels [N] >= -1 as 0 ... R-1 in order of first appearance, and R."""
    size = int(labels.max()) + 2
    if size > 4 * len(labels) + 1024:  # too sparse to index by: sort. Anything below is 5 times faster without.
        values, labels = labels.unique(return_inverse=True)
        size = len(values)
    else:
        labels = labels + 1
    position = torch.arange(len(labels))
    first = torch.full((size,), len(labels)).scatter_reduce(0, labels, position, "amin")
    number = torch.empty_like(first)
    number[first.argsort()] = torch.arange(size)  # labels that do not occur come last
    return number[labels], int((first < len(labels)).sum())


def _count(key: Tensor, size: int) -> tuple[Tensor, Tensor]:
    """The distinct keys of [N] keys in 0 ... size-1, ascending, and how often each occurs."""
    if size > 4 * len(key) + 1024:
        return key.unique(return_counts=True)
    counts = torch.bincount(key, minlength=size)
    values = counts.nonzero().flatten()
    return values, counts[values]


def _largest(value: Tensor, index: Tensor, size: int) -> Tensor:
    return value.new_zeros(size).scatter_reduce(0, index, value, "amax")


def _weighted_mean(value: Tensor, weight: Tensor) -> float:
    return ((value * weight).sum() / weight.sum()).item()


def _step_sum(curve: list[ObjectsAndParts]) -> float:
    area = reached = 0.0
    for precision, recall, _ in sorted(curve, key=lambda point: point.recall):
        area += (recall - reached) * precision
        reached = recall
    return area


def _checked(pred: Tensor, target: Tensor | Sequence[Tensor]) -> tuple[Tensor, list[Tensor]]:
    """Both as flat int64, the ground truths as a list."""
    flat = _checked_labels(pred, "pred")
    named = (
        {"target": target} if not isinstance(target, Sequence) else {f"target[{i}]": t for i, t in enumerate(target)}
    )
    if not named:
        raise ValueError("target: expected at least one ground truth, got an empty sequence")
    targets = []
    for name, one in named.items():
        targets.append(_checked_labels(one, name))
        if one.shape != pred.shape:
            raise ValueError(f"{name}: expected the shape of pred, {tuple(pred.shape)}, got {tuple(one.shape)}")
        if int(targets[-1].max()) < 0:
            raise ValueError(f"{name}: expected at least one label >= 0, got nothing but -1 (void)")
    return flat, targets


def _checked_labels(labels: Tensor, name: str) -> Tensor:
    got = labels.dtype if isinstance(labels, Tensor) else type(labels).__name__
    if got not in (torch.uint8, torch.int8, torch.int16, torch.int32, torch.int64):
        raise TypeError(f"{name}: expected an integer tensor, got {got}")
    if labels.numel() == 0:
        raise ValueError(f"{name}: expected at least one label, got an empty tensor of shape {tuple(labels.shape)}")
    flat = labels.to("cpu", torch.int64).flatten()
    if int(flat.min()) < -1:
        raise ValueError(f"{name}: expected labels >= -1, got {int(flat.min())}")
    return flat


def _check_thresholds(gamma_object: float, gamma_part: float, beta: float) -> None:
    if not 0 < gamma_object <= 1:
        raise ValueError(f"gamma_object: expected a number in (0, 1], got {gamma_object}")
    if not 0 < gamma_part <= gamma_object:
        raise ValueError(f"gamma_part: expected a number in (0, gamma_object = {gamma_object}], got {gamma_part}")
    if not 0 <= beta <= 1:
        raise ValueError(f"beta: expected a number in [0, 1], got {beta}")
