"""Scores by kind of instance, for example thin or flat instances."""

from __future__ import annotations

from statistics import fmean

import torch
from torch import Tensor

from torchjoint.metrics.overlaps import overlap_tables
from torchjoint.runtime.groups import renumber_by_value
from torchjoint.scene import Truth
from torchjoint_lab.evaluation.partial_truth import knows_points

#: Instances with fewer points are ignored: nearly nothing of them was seen.
MIN_POINTS = 20


def best_iou_by_kind(points: Tensor, truth: Truth) -> dict[str, float]:
    """Mean best IoU of the instances of each kind in ``truth.kinds``, over instances of :data:`MIN_POINTS` or more.

    Args:
        points: [N] int64, the predicted labels.
        truth: ground truth of the same N points.

    Returns:
        Mean best IoU by kind; kinds without such instances are left out.

    Raises:
        TypeError, ValueError: as :func:`torchjoint.metrics.mean_best_iou`.
    """
    if not truth.kinds or truth.points is None or not knows_points(truth):
        return {}
    table = overlap_tables(points, truth.points)[1][0]
    scores = zip(_instances(truth.points), table.best_iou_of_target.tolist(), table.target_area.tolist(), strict=True)
    by_kind: dict[str, list[float]] = {kind: [] for kind in dict.fromkeys(truth.kinds.values())}
    for instance, iou, area in scores:
        if instance in truth.kinds and area >= MIN_POINTS:
            by_kind[truth.kinds[instance]].append(iou)
    return {kind: fmean(values) for kind, values in sorted(by_kind.items()) if values}


def _instances(labels: Tensor) -> list[int]:
    """The distinct labels >= 0 of [N], by first appearance: the order of regions in an overlap table."""
    values, place = renumber_by_value(labels)
    known = (place >= 0).nonzero().flatten()
    first = torch.full((len(values),), len(labels)).scatter_reduce(0, place[known], known, "amin")
    return values[first.argsort()].tolist()
