"""Scores against a truth that knows only some things: of real recordings, and of streets.

Points are of three kinds. Those of things are instances. Void points never count. All others are known to be no thing:
they count only where a segment mixes them with one.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint.metrics.objects_and_parts import objects_and_parts_of
from torchjoint.metrics.overlaps import Overlaps
from torchjoint.scene import Truth


def knows_points(truth: Truth) -> bool:
    """Whether the instance of any point is known."""
    return truth.points is not None and bool((truth.points >= 0).any())


def knows(truth: Truth) -> bool:
    """Whether it says anything of points or images."""
    return knows_points(truth) or len(truth.images) > 0


class PartialTruth(NamedTuple):
    """What is known about N points."""

    instance: Tensor  #: [N] int64, -1 = none
    other: Tensor  #: [N] bool, points of no instance that count where they leak into one

    @property
    def counts(self) -> Tensor:
        """[N] bool, the points that are not void."""
        return (self.instance >= 0) | self.other


class Score(NamedTuple):
    """Scores in [0, 1]."""

    f: float  #: for objects and parts
    best_iou: float  #: mean over the instances
    found: float  #: share of the instances with an IoU of more than .5


def judge(labels: Tensor, truth: PartialTruth) -> Score:
    """Scores labels [N] int64; a point with -1 is in no segment.

    If all points that count are of instances, F and best IoU are those of :mod:`torchjoint.metrics`.
    """
    none = labels < 0
    labels = torch.where(none, int(labels.max()) + 1 + none.cumsum(0), labels)
    counts = truth.counts
    region = labels[counts].unique(return_inverse=True)[1]
    instance = truth.instance[counts]
    known = instance >= 0
    num_regions = int(region.max()) + 1
    table = Overlaps(region[known], num_regions, instance[known])
    # What leaks into a region is of no instance, but belongs to the region's size.
    table.pred_area = torch.bincount(region, minlength=num_regions)
    table.precision = table.count.double() / table.pred_area[table.pred]
    iou = table.count / (table.pred_area[table.pred] + table.target_area[table.target] - table.count).double()
    is_none = torch.zeros(num_regions, dtype=torch.bool)
    is_none[region[none[counts]]] = True
    iou[is_none[table.pred]] = 0
    best = iou.new_zeros(len(table.target_area)).scatter_reduce(0, table.target, iou, "amax")
    # Regions of houses and hedges are not judged, unless they hold most of an instance.
    of_instances = torch.bincount(region[known], minlength=num_regions)
    judged = 2 * of_instances >= table.pred_area
    judged[table.pred[table.recall >= 0.5]] = True
    judged &= ~is_none
    f = objects_and_parts_of(torch.where(judged, table.pred_area, 0), [table]).f
    return Score(f, best.mean().item(), (best > 0.5).double().mean().item())
