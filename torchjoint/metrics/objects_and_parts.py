"""Precision and recall for objects and parts, and average precisions over both.

J. Pont-Tuset and F. Marques, "Supervised Evaluation of Image Segmentation and Object Proposal Techniques" (PAMI 2016).
"""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint.metrics.overlaps import Overlaps, largest, overlap_tables
from torchjoint.runtime.threads import on_cpu

#: Candidates are the largest regions that together hold this share of the data; smaller regions do not count.
CANDIDATE_SHARE = 0.99

_NONE, _PART, _OBJECT = 0, 1, 2


class ObjectsAndParts(NamedTuple):
    """Precision and recall for objects and parts, in [0, 1], and their harmonic mean (0 if both are 0)."""

    precision: float
    recall: float
    f: float


def objects_and_parts(
    pred: Tensor,
    target: Tensor | Sequence[Tensor],
    gamma_object: float = 0.75,
    gamma_part: float = 0.25,
    beta: float = 0.1,
) -> ObjectsAndParts:
    """Computes precision and recall for objects and parts.

    A predicted and a true region are objects if their overlap is at least ``gamma_object`` of both. A region is a part
    if at least ``gamma_object`` of it lies within the other region and it fills at least ``gamma_part`` of the other.
    An object counts 1, and a part counts ``beta``. Any other region counts its fragmentation: the share of the region
    that is filled by regions within it.

    With several ground truths, recall counts the regions of all of them. A predicted region is an object if it is an
    object for any ground truth, and its fragmentation is the mean over the ground truths. The predicted candidates are
    chosen among the points that are labelled in at least one ground truth.

    Args:
        pred: int64, any shape.
        target: int64 of the same shape, -1 = void; or a sequence of such tensors.
        gamma_object: smallest overlap of an object. If it is 0.5 or less, a true region may match several predicted
            regions as object or as part; then the last of them counts (in row-major order of first appearance).
        gamma_part: smallest overlap of a part, 0 < gamma_part <= gamma_object <= 1.
        beta: value of a part, in [0, 1].

    Raises:
        TypeError, ValueError: as :func:`torchjoint.metrics.segmentation_covering`;
            ValueError also for thresholds out of range.

    >>> import torch
    >>> objects_and_parts(torch.tensor([0, 0, 1, 1]), torch.tensor([5, 5, 5, 5]))  # two parts of one object
    ObjectsAndParts(precision=0.1, recall=1.0, f=0.18181818181818182)
    """
    return objects_and_parts_of(*overlap_tables(pred, target), gamma_object, gamma_part, beta)


def average_precision_objects(
    pred: Tensor, target: Tensor | Sequence[Tensor], gamma_part: float = 0.25, beta: float = 0.1
) -> float:
    """AP_o: :func:`objects_and_parts` integrated over ``gamma_object`` = .50, .55, ... .95.

    The paper does not define the integral. Here the points are sorted by rising recall, and AP_o is the step sum
    ``sum (Re_i - Re_{i-1}) Pr_i`` with Re_0 = 0, separately for each sample. Arguments and errors: as
    :func:`objects_and_parts`.
    """
    return average_precision_objects_of(*overlap_tables(pred, target), gamma_part, beta)


def average_precision_parts(
    pred: Tensor, target: Tensor | Sequence[Tensor], gamma_object: float = 0.75, beta: float = 0.1
) -> float:
    """AP_p: as :func:`average_precision_objects`, but over ``gamma_part`` = .05, .10, ... .70."""
    return average_precision_parts_of(*overlap_tables(pred, target), gamma_object, beta)


def average_precision_objects_of(
    pred_area: Tensor, tables: Sequence[Overlaps], gamma_part: float = 0.25, beta: float = 0.1
) -> float:
    """Returns :func:`average_precision_objects` from existing tables."""
    return _step_sum([objects_and_parts_of(pred_area, tables, k / 20, gamma_part, beta) for k in range(10, 20)])


def average_precision_parts_of(
    pred_area: Tensor, tables: Sequence[Overlaps], gamma_object: float = 0.75, beta: float = 0.1
) -> float:
    """Returns :func:`average_precision_parts` from existing tables."""
    return _step_sum([objects_and_parts_of(pred_area, tables, gamma_object, k / 20, beta) for k in range(1, 15)])


@on_cpu()
def objects_and_parts_of(
    pred_area: Tensor,
    tables: Sequence[Overlaps],
    gamma_object: float = 0.75,
    gamma_part: float = 0.25,
    beta: float = 0.1,
) -> ObjectsAndParts:
    """Returns :func:`objects_and_parts` from the result of :func:`torchjoint.metrics.overlaps.overlap_tables`."""
    check_thresholds(gamma_object, gamma_part, beta)
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

        # For a predicted region the best match over all ground truths counts (object before part).
        found = is_object * _OBJECT + pred_is_part * _PART
        pred_class = torch.maximum(pred_class, largest(found, table.pred, len(pred_class)))
        # For a true region the last match counts: an asymmetry of the metric, relevant only if gamma_object <= 0.5.
        found = is_object * _OBJECT + target_is_part * _PART
        ranked = torch.where(found > _NONE, table.pred * 3 + found, 0)
        target_class = largest(ranked, table.target, len(table.target_area)) % 3

        pred_fragments += torch.bincount(table.pred, table.precision * (fills & ~within), len(pred_class)) / len(tables)
        fragments = torch.bincount(table.target, table.recall * (within & ~fills), len(target_class))
        recalled += _worth(target_class, fragments, target_candidate, beta)
        expected += int(target_candidate.sum())
    precision = _worth(pred_class, pred_fragments, pred_candidate, beta) / int(pred_candidate.sum())
    recall = recalled / expected
    f = 2 * precision * recall / (precision + recall) if precision + recall > 0 else 0.0
    return ObjectsAndParts(precision, recall, f)


def _candidates(area: Tensor) -> Tensor:
    """[R] bool: the largest regions that together reach CANDIDATE_SHARE of the area. Ties: the later region first."""
    order = area.flip(0).argsort(descending=True, stable=True)
    share = (area.flip(0)[order].double() / area.sum()).cumsum(0)
    before = torch.cat([share.new_zeros(1), share[:-1]])
    candidate = torch.zeros_like(area, dtype=torch.bool)
    candidate[len(area) - 1 - order] = before < CANDIDATE_SHARE
    return candidate


def _worth(found: Tensor, fragments: Tensor, candidate: Tensor, beta: float) -> float:
    objects, parts = int((found == _OBJECT).sum()), int((found == _PART).sum())
    return objects + beta * parts + fragments[candidate & (found == _NONE)].sum().item()


def _step_sum(curve: list[ObjectsAndParts]) -> float:
    area = reached = 0.0
    for precision, recall, _ in sorted(curve, key=lambda point: point.recall):
        area += (recall - reached) * precision
        reached = recall
    return area


def check_thresholds(gamma_object: float, gamma_part: float, beta: float) -> None:
    """Raises ValueError if a threshold is out of range."""
    if not 0 < gamma_object <= 1:
        raise ValueError(f"gamma_object: expected a number in (0, 1], got {gamma_object}")
    if not 0 < gamma_part <= gamma_object:
        raise ValueError(f"gamma_part: expected a number in (0, gamma_object = {gamma_object}], got {gamma_part}")
    if not 0 <= beta <= 1:
        raise ValueError(f"beta: expected a number in [0, 1], got {beta}")
