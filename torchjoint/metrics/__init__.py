"""How good a class-agnostic segmentation is: functions of label tensors, and classes that accumulate them over scenes.

Everything is computed from one table: how many points each predicted region shares with each true one.

Convention: labels are integers >= -1 of one shape, whatever that shape is (points [N], an image [H, W], a stack of
images). -1 in ``target`` is void: dropped before anything is counted. -1 in ``pred`` is "unlabelled": all of it
together is one background region. Which number a region has never matters. ``target`` may be a sequence of several
ground truths of the same data, such as several annotators'. (ScanNet's average precision, which is about masks, has
its own rules for void, for what is unlabelled, and for several ground truths.)

A data set's value is the mean of its samples' values, F included (but for ScanNet's average precision), which is what
the classes compute: ``FooMetric`` for ``foo``, on torchmetrics, which is imported when one of them is first asked for.

>>> import torch, torchjoint as tj
>>> metric = tj.metrics.ObjectsAndPartsMetric()
>>> metric.update(torch.tensor([0, 0, 1, 1]), torch.tensor([0, 0, 0, 0]))
>>> metric.compute().recall
1.0
"""

from typing import TYPE_CHECKING

from torchjoint.metrics.covering import SegmentationCovering, mean_best_iou, segmentation_covering
from torchjoint.metrics.objects_and_parts import (
    ObjectsAndParts,
    average_precision_objects,
    average_precision_parts,
    objects_and_parts,
)
from torchjoint.metrics.scannet import AveragePrecision, scannet_average_precision
from torchjoint.metrics.superpoints import (
    achievable_segmentation_accuracy,
    boundary_recall,
    undersegmentation_error,
)

if TYPE_CHECKING:
    from torchjoint.metrics.modules import (
        AchievableSegmentationAccuracyMetric,
        AveragePrecisionObjectsMetric,
        AveragePrecisionPartsMetric,
        BoundaryRecallMetric,
        MeanBestIoUMetric,
        ObjectsAndPartsMetric,
        ScannetAveragePrecisionMetric,
        SegmentationCoveringMetric,
        UndersegmentationErrorMetric,
    )

__all__ = [
    "AchievableSegmentationAccuracyMetric",
    "AveragePrecision",
    "AveragePrecisionObjectsMetric",
    "AveragePrecisionPartsMetric",
    "BoundaryRecallMetric",
    "MeanBestIoUMetric",
    "ObjectsAndParts",
    "ObjectsAndPartsMetric",
    "ScannetAveragePrecisionMetric",
    "SegmentationCovering",
    "SegmentationCoveringMetric",
    "UndersegmentationErrorMetric",
    "achievable_segmentation_accuracy",
    "average_precision_objects",
    "average_precision_parts",
    "boundary_recall",
    "mean_best_iou",
    "objects_and_parts",
    "scannet_average_precision",
    "segmentation_covering",
    "undersegmentation_error",
]


def __getattr__(name: str) -> type:
    if name in __all__:  # one of the classes: the functions are here already
        from torchjoint.metrics import modules

        metric: type = getattr(modules, name)
        return metric
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
