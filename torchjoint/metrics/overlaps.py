"""The table behind all metrics: the number of points that each predicted region shares with each true region."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from torchjoint.metrics.labels import checked_pair
from torchjoint.runtime.first_places import numbers_by_first_place
from torchjoint.runtime.threads import on_cpu


class Overlaps:
    """The E pairs of a predicted and a true region that share points. Regions are numbered by first appearance."""

    def __init__(self, pred: Tensor, num_pred: int, target: Tensor) -> None:
        target, num_target = _by_first_appearance(target)
        key, self.count = count_keys(pred * num_target + target, num_pred * num_target)  # [E] shared points
        self.pred, self.target = key // num_target, key % num_target  # [E], ascending
        self.pred_area = torch.bincount(pred, minlength=num_pred)  # [P]; 0 where this ground truth is void
        self.target_area = torch.bincount(target)  # [T]
        areas = self.pred_area[self.pred] + self.target_area[self.target]
        iou = self.count.double() / (areas - self.count)
        self.precision = self.count.double() / self.pred_area[self.pred]
        self.recall = self.count.double() / self.target_area[self.target]
        self.best_iou_of_pred = largest(iou, self.pred, num_pred)
        self.best_iou_of_target = largest(iou, self.target, num_target)


@on_cpu()
def overlap_tables(pred: Tensor, target: Tensor | Sequence[Tensor]) -> tuple[Tensor, list[Overlaps]]:
    """Returns the predicted regions' areas [P] and one table per ground truth, all with the same P.

    Raises:
        TypeError, ValueError: as :func:`torchjoint.metrics.labels.checked_pair`.
    """
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


def renumber_by_value(labels: Tensor) -> tuple[Tensor, Tensor]:
    """Returns the distinct labels [R] >= 0 of [N] labels >= -1, ascending, and each label's index [N]; -1 for -1."""
    size = int(labels.max()) + 2
    if size > 4 * len(labels) + 1024:
        values, place = labels.unique(return_inverse=True)
        none = int(values[0] < 0)
        return values[none:], place - none
    present = torch.zeros(size, dtype=torch.bool)
    present[labels + 1] = True
    present[0] = False
    place = present.cumsum(0) - 1
    place[0] = -1
    return present.nonzero().flatten() - 1, place[labels + 1]


def places(mask: Tensor) -> Tensor:
    """Returns the indices [M] int64 where [N] bool is True, by NumPy: several times faster than by torch."""
    return torch.from_numpy(mask.numpy().nonzero()[0])


def _by_first_appearance(labels: Tensor) -> tuple[Tensor, int]:
    """Renumbers labels [N] >= -1 to 0 ... R-1 in order of first appearance; returns also R."""
    size = int(labels.max()) + 2
    if size > 4 * len(labels) + 1024:  # too sparse for direct indexing: sort instead (5 times slower below this limit)
        values, labels = labels.unique(return_inverse=True)
        size = len(values)
    else:
        labels = labels + 1
    number = numbers_by_first_place(labels, size)[labels]
    return number, int(number.max()) + 1
