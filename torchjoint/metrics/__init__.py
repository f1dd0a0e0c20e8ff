"""Metrics of class-agnostic segmentation: functions of label tensors.

All metrics are computed from one table: the number of points that each predicted region shares with each true region.

Convention: labels are integers >= -1 of any common shape (points [N], an image [H, W], a stack of images). -1 in
``target`` is void: void points are dropped first. -1 in ``pred`` is "unlabelled": all unlabelled points form one
background region. The ids of regions have no effect. ``target`` may be a sequence of several ground truths of the
same data, for example of several annotators. (ScanNet's average precision, a metric of masks, has its own rules for
void, unlabelled points, and several ground truths.)

The value of a data set, also F, is the mean of the values of its samples, for example by `torchmetrics.MeanMetric`.
Only ScanNet's average precision is not: :class:`ScannetAveragePrecisionMetric` accumulates it, on torchmetrics, which
is imported when the class is first used.

>>> import torch, torchjoint as tj
>>> tj.metrics.objects_and_parts(torch.tensor([0, 0, 1, 1]), torch.tensor([0, 0, 0, 0])).recall
1.0
"""

from typing import TYPE_CHECKING

from torchjoint.metrics.objects_and_parts import (
    ObjectsAndParts,
    average_precision_objects,
    average_precision_parts,
    objects_and_parts,
)
from torchjoint.metrics.overlaps import SegmentationCovering, mean_best_iou, segmentation_covering
from torchjoint.metrics.scannet import AveragePrecision, scannet_average_precision
from torchjoint.metrics.superpoints import achievable_segmentation_accuracy, boundary_recall, undersegmentation_error
from torchjoint.runtime.messages import needed_for

if TYPE_CHECKING:
    from torchjoint.metrics.modules import ScannetAveragePrecisionMetric

__all__ = [
    "AveragePrecision", "ObjectsAndParts", "ScannetAveragePrecisionMetric", "SegmentationCovering",
    "achievable_segmentation_accuracy", "average_precision_objects", "average_precision_parts", "boundary_recall",
    "mean_best_iou", "objects_and_parts", "scannet_average_precision", "segmentation_covering",
    "undersegmentation_error",
]  # fmt: skip


def __getattr__(name: str) -> type:
    if name == "ScannetAveragePrecisionMetric":
        with needed_for(f"tj.metrics.{name}", "torchmetrics", "torchjoint[metrics]"):
            from torchjoint.metrics.modules import ScannetAveragePrecisionMetric
        return ScannetAveragePrecisionMetric
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
