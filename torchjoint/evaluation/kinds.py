"""How well the instances of each kind are found."""

from __future__ import annotations

from statistics import fmean

import torch
from torch import Tensor

from torchjoint.metrics.overlaps import by_value, overlap_tables
from torchjoint.scene import Truth

#: Instances with fewer points do not count: hardly anything of them was seen.
LEAST_POINTS = 20


def best_iou_by_kind(points: Tensor, truth: Truth) -> dict[str, float]:
    """Mean best IoU of the instances of each kind of ``truth.kinds`` that has any of :data:`LEAST_POINTS` points.

    Args:
        points: [N] int64, the labels to be judged.
        truth: of the same N points.

    Raises:
        TypeError, ValueError: as :func:`torchjoint.metrics.mean_best_iou`.
    """
    if not truth.kinds or truth.points is None or not truth.has_points:
        return {}
    table = overlap_tables(points, truth.points)[1][0]
    scores = zip(_instances(truth.points), table.best_iou_of_target.tolist(), table.target_area.tolist(), strict=True)
    by_kind: dict[str, list[float]] = {kind: [] for kind in dict.fromkeys(truth.kinds.values())}
    for instance, iou, area in scores:
        if instance in truth.kinds and area >= LEAST_POINTS:
            by_kind[truth.kinds[instance]].append(iou)
    return {kind: fmean(values) for kind, values in sorted(by_kind.items()) if values}


def _instances(labels: Tensor) -> list[int]:
    """The distinct labels >= 0 of [N], by first appearance: the order of a table of overlaps."""
    values, place = by_value(labels)
    known = (place >= 0).nonzero().flatten()
    first = torch.full((len(values),), len(labels)).scatter_reduce(0, place[known], known, "amin")
    return values[first.argsort()].tolist()
