"""Segmentation covering, and the best IoU of every ground-truth instance."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import fmean
from typing import NamedTuple

from torch import Tensor

from torchjoint.metrics.overlaps import Overlaps, overlap_tables
from torchjoint.runtime.threads import on_cpu


class SegmentationCovering(NamedTuple):
    """Coverings in [0, 1]: the mean of the next two; C(pred -> target), the usual one; and C(target -> pred)."""

    symmetric: float
    target_by_pred: float
    pred_by_target: float


@on_cpu()
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


@on_cpu()
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
