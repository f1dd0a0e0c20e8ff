"""Average precision of instances as in the ScanNet benchmark, but class-agnostic.

A. Dai et al., "ScanNet: Richly-annotated 3D Reconstructions of Indoor Scenes" (CVPR 2017), and the evaluation of 3D
instances in its benchmark. The rules, in addition to the IoU of masks:

* A mask and an instance match if their IoU is above the threshold. Void points count in a mask's area.
* Masks and instances below the smallest size are left out.
* Instances are processed by ascending label. Each takes the masks that match it and that no earlier instance has
  claimed. The best score of these masks becomes a true positive, and all other scores become false positives. The
  mask with the lowest number is claimed. Only below a threshold of 0.5 can a mask match several instances, so only
  there do the numbers have an effect.
* A mask without a match is a false positive, unless a share of it above the threshold is void or belongs to
  instances that are too small.
* The predictions of all scenes make one precision-recall curve; masks with the same score make one point. Its area is
  the sum of trapezoids, starting at recall 0, precision 1.
"""

from collections.abc import Sequence
from itertools import groupby
from statistics import fmean
from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint.metrics.masks import Intersections, intersect
from torchjoint.metrics.overlaps import checked_targets
from torchjoint.runtime.threads import on_cpu

#: IoU thresholds: the one of AP25, then those averaged for AP, of which the first is the one of AP50.
THRESHOLDS = (0.25, *(k / 20 for k in range(10, 19)))


class AveragePrecision(NamedTuple):
    """Mean over the IoU thresholds .50, .55, ... .90, and AP at .50 and .25; in [0, 1]; nan without a true instance."""

    ap: float
    ap50: float
    ap25: float


class Matches(NamedTuple):
    """True and false positives at all thresholds. The matches of several scenes are concatenated."""

    threshold: Tensor  #: [M] float64, the number of one of THRESHOLDS, which every dtype keeps
    score: Tensor  #: [M] float64
    hit: Tensor  #: [M] float64, 1 = true positive, 0 = false positive


@on_cpu()
def scannet_average_precision(
    pred: Tensor | Sequence[Tensor],
    target: Tensor | Sequence[Tensor],
    scores: Tensor | None = None,
    *,
    min_size: int = 100,
) -> AveragePrecision:
    """Computes class-agnostic AP, AP50 and AP25 of one scene, by the rules of the ScanNet benchmark (see the module).

    The AP of a data set is not the mean over its scenes: use
    :class:`torchjoint.metrics.ScannetAveragePrecisionMetric`. Several ground truths count as several scenes. Unlike in
    the other metrics, void is not dropped, and unlabelled points are not a region.

    Args:
        pred: labels, int64 of the target's shape, -1 = no instance; or masks that may overlap, bool [K, ...] with the
            target's shape after the first axis; or K int64 tensors of point indices into the flattened target.
        target: int64, any shape, -1 = void; or a sequence of such tensors.
        scores: [K], finite: one per mask, or ``scores[label]`` per label. None: all scores are equal, for methods
            without scores. The curve is then one point, and its area is recall x (1 + precision) / 2.
        min_size: smallest size, in points; 100 in the benchmark.

    Raises:
        TypeError: labels that are not integer tensors, masks that are not bool, scores that are not a tensor.
        ValueError: shapes that differ, labels or points out of range, only void labels, scores that are missing or not
            finite, min_size below 1.

    >>> import torch
    >>> target = torch.tensor([0, 0, 0, 0, 1, 1])
    >>> scannet_average_precision(torch.tensor([0, 0, 0, 2, 1, 1]), target, min_size=1)  # 3/4, 1; and one too many
    AveragePrecision(ap=0.6111111111111112, ap50=0.8333333333333333, ap25=0.8333333333333333)
    """
    matches, num_instances = match_instances(pred, target, scores, min_size)
    return areas(matches, num_instances)


def match_instances(
    pred: Tensor | Sequence[Tensor], target: Tensor | Sequence[Tensor], scores: Tensor | None, min_size: int
) -> tuple[Matches, int]:
    """Returns the matches of a scene and its number of true instances; arguments and errors: as for the metric."""
    check_min_size(min_size)
    checked_targets(target)
    found, num_instances = [], 0
    for one in target if isinstance(target, Sequence) else [target]:
        table, labels = intersect(pred, one.to("cpu", torch.int64))
        found.append(_match(table, _checked_scores(scores, labels, len(table.mask_area)), min_size))
        num_instances += int((table.column_area[1:] >= min_size).sum())
    return Matches(*map(torch.cat, zip(*found, strict=True))), num_instances


def areas(matches: Matches, num_instances: int) -> AveragePrecision:
    """Returns the average precisions from the matches of one or several scenes."""
    at = [_area(matches, number, num_instances) for number in range(len(THRESHOLDS))]
    return AveragePrecision(fmean(at[1:]), at[1], at[0])


def check_min_size(min_size: int) -> None:
    """Raises ValueError if `min_size` is below 1."""
    if not min_size >= 1:
        raise ValueError(f"min_size: expected at least 1 point, got {min_size}")


def _match(table: Intersections, score: Tensor, min_size: int) -> Matches:
    counted = table.column_area >= min_size
    counted[0] = False
    large = table.mask_area >= min_size
    ignored = torch.where(counted[table.column], 0, table.shared)
    ignored_share = torch.bincount(table.mask, ignored.double(), len(large)) / table.mask_area
    iou = table.shared / (table.mask_area[table.mask] + table.column_area[table.column] - table.shared).double()
    iou[~(large[table.mask] & counted[table.column])] = 0

    found: list[tuple[float, float, float]] = []
    for number, threshold in enumerate(THRESHOLDS):
        match = (iou > threshold).nonzero().flatten()
        for instance_scores in _claimed(table.column[match], table.mask[match], score):
            found.extend((number, one, 0.0) for one in instance_scores[:-1])
            found.append((number, instance_scores[-1], 1.0))
        alone = large.index_fill(0, table.mask[match], False) & (ignored_share <= threshold)
        found.extend((number, one, 0.0) for one in score[alone].tolist())
    return Matches(*torch.tensor(found, dtype=torch.float64).reshape(len(found), 3).unbind(1))


def _claimed(instance: Tensor, mask: Tensor, score: Tensor) -> list[list[float]]:
    """The scores, ascending, of the masks that each instance takes; only for instances that take any mask."""
    pairs = sorted(zip(instance.tolist(), mask.tolist(), score[mask].tolist(), strict=True))
    claimed: set[int] = set()
    result = []
    for _, group in groupby(pairs, key=lambda pair: pair[0]):
        free = [(mask, score) for _, mask, score in group if mask not in claimed]
        if free:
            claimed.add(free[0][0])
            result.append(sorted(score for _, score in free))
    return result


def _area(matches: Matches, number: int, num_instances: int) -> float:
    if num_instances == 0:
        return float("nan")
    at = matches.threshold == number
    scores, point = matches.score[at].unique(return_inverse=True)
    hits = torch.bincount(point, matches.hit[at], len(scores)).flip(0).cumsum(0)  # from the highest score down
    precision = hits / torch.bincount(point, minlength=len(scores)).flip(0).cumsum(0)
    start = precision.new_zeros(1)
    return torch.trapezoid(torch.cat([start + 1, precision]), torch.cat([start, hits / num_instances])).item()


def _checked_scores(scores: Tensor | None, labels: Tensor | None, count: int) -> Tensor:
    """The score of each instance, [K] float64."""
    if scores is None:
        return torch.ones(count, dtype=torch.float64)
    if not isinstance(scores, Tensor) or scores.is_complex() or scores.layout != torch.strided or scores.is_nested:
        raise TypeError(f"scores: expected a tensor of real numbers, got {getattr(scores, 'dtype', type(scores))}")
    if labels is not None:
        if scores.dim() != 1 or (len(labels) and int(labels[-1]) >= len(scores)):
            highest = int(labels[-1]) if len(labels) else -1
            raise ValueError(f"scores: expected a score for each label up to {highest}, got {tuple(scores.shape)}")
        scores = scores[labels.to(scores.device)]
    elif scores.shape != (count,):
        raise ValueError(f"scores: expected shape ({count},), one for each mask, got {tuple(scores.shape)}")
    scores = scores.to("cpu", torch.float64)
    if not scores.isfinite().all():
        raise ValueError("scores: expected finite numbers, got nan or infinity")
    return scores
