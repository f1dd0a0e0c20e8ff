"""Metrics that add up over scenes, as modules of torchmetrics."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor
from torchmetrics import Metric
from torchmetrics.utilities import dim_zero_cat

from torchjoint.metrics.objects_and_parts import (
    ObjectsAndParts,
    average_precision_objects,
    average_precision_parts,
    check_thresholds,
    objects_and_parts,
)
from torchjoint.metrics.overlaps import SegmentationCovering, mean_best_iou, segmentation_covering
from torchjoint.metrics.scannet import AveragePrecision, Matches, areas, check_min_size, match_instances
from torchjoint.metrics.superpoints import (
    achievable_segmentation_accuracy,
    boundary_recall,
    check_tolerance,
    undersegmentation_error,
)


def add_options_state(metric: Metric, *options: float) -> None:
    """Adds a state that is equal only for metrics of the same class and options.

    A :class:`torchmetrics.MetricCollection` groups metrics whose states have equal names and values after the first
    update, and then updates only one metric per group. Without this state a perfect sample would group other metrics.
    """
    metric.add_state(
        f"options_of_{type(metric).__name__}", torch.tensor([0.0, *options], dtype=torch.float64), dist_reduce_fx="max"
    )


class ScannetAveragePrecisionMetric(Metric):
    """:func:`torchjoint.metrics.scannet_average_precision` of a data set; all scenes make one curve.

    Args:
        min_size: as for the function.
        kwargs: as for :class:`torchmetrics.Metric`.

    >>> import torch
    >>> target = torch.tensor([0, 0, 1, 1])
    >>> metric = ScannetAveragePrecisionMetric(min_size=1)
    >>> metric.update(torch.tensor([0, 0, 1, 1]), target, scores=torch.tensor([0.9, 0.8]))
    >>> metric.update(torch.tensor([0, 1, 2, 3]), target, scores=torch.tensor([0.4, 0.3, 0.2, 0.1]))
    >>> metric.compute()  # half of the instances are found before anything is wrong
    AveragePrecision(ap=0.5, ap50=0.5, ap25=0.94375)
    """

    is_differentiable = False
    higher_is_better = True
    full_state_update = False
    threshold: list[Tensor]
    score: list[Tensor]
    hit: list[Tensor]
    num_scenes: Tensor
    num_instances: Tensor

    def __init__(self, min_size: int = 100, **kwargs: Any) -> None:
        check_min_size(min_size)
        super().__init__(**kwargs)
        add_options_state(self, min_size)
        self.min_size = min_size
        for name in Matches._fields:
            self.add_state(name, [], dist_reduce_fx="cat")
        self.add_state("num_scenes", torch.tensor(0), dist_reduce_fx="sum")
        self.add_state("num_instances", torch.tensor(0), dist_reduce_fx="sum")
        self.set_dtype(torch.float64)  # the empty list state of a process without scenes needs the same dtype

    def update(
        self, pred: Tensor | Sequence[Tensor], target: Tensor | Sequence[Tensor], scores: Tensor | None = None
    ) -> None:
        """Adds one scene: labels, masks or points of the predicted instances; the true labels; scores."""
        matches, num_instances = match_instances(pred, target, scores, self.min_size)
        for name, values in zip(Matches._fields, matches, strict=True):
            getattr(self, name).append(values.to(self.device))
        self.num_instances += num_instances
        self.num_scenes += 1

    def compute(self) -> AveragePrecision:
        """Returns the AP of all scenes so far. ValueError without a scene; nan if no instance is large enough."""
        if int(self.num_scenes) == 0:
            raise ValueError(f"{type(self).__name__}: expected an update before compute, got none")
        return areas(Matches(*(dim_zero_cat(getattr(self, name)) for name in Matches._fields)), int(self.num_instances))


class _SampleMean(Metric):
    """The mean over samples of the values of a function; `options` are its further arguments."""

    is_differentiable = False
    higher_is_better = True
    full_state_update = False
    total: Tensor
    num_samples: Tensor
    _function: Callable[..., float | tuple[float, ...]]

    def __init__(self, *, num_values: int = 1, options: Sequence[float] = (), **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self._options = tuple(options)
        add_options_state(self, *options)
        self.add_state("total", torch.zeros(num_values, dtype=torch.float64), dist_reduce_fx="sum")
        self.add_state("num_samples", torch.tensor(0), dist_reduce_fx="sum")

    def update(self, pred: Tensor, target: Tensor | Sequence[Tensor]) -> None:
        """Adds one sample: two label tensors of one shape."""
        self._add(type(self)._function(pred, target, *self._options))

    def _add(self, values: float | tuple[float, ...]) -> None:
        self.total += torch.tensor(values, dtype=torch.float64, device=self.total.device)
        self.num_samples += 1

    def _mean(self) -> Tensor:
        if int(self.num_samples) == 0:
            raise ValueError(f"{type(self).__name__}: expected an update before compute, got none")
        return self.total / self.num_samples


class SegmentationCoveringMetric(_SampleMean):
    """:func:`torchjoint.metrics.segmentation_covering`, averaged over samples.

    Args:
        kwargs: as for :class:`torchmetrics.Metric`.

    >>> import torch
    >>> metric = SegmentationCoveringMetric()
    >>> metric.update(torch.tensor([0, 0, 1, 1]), torch.tensor([5, 5, 5, 5]))
    >>> metric.update(torch.tensor([0, 0, 1, 1]), torch.tensor([5, 5, 6, 6]))
    >>> metric.compute()
    SegmentationCovering(symmetric=0.75, target_by_pred=0.75, pred_by_target=0.75)
    """

    _function = staticmethod(segmentation_covering)

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(num_values=len(SegmentationCovering._fields), **kwargs)

    def compute(self) -> SegmentationCovering:
        """Returns means over the samples. ValueError without a sample."""
        return SegmentationCovering(*self._mean().tolist())


class ObjectsAndPartsMetric(_SampleMean):
    """:func:`torchjoint.metrics.objects_and_parts`, averaged over samples, also F.

    Args:
        gamma_object, gamma_part, beta: as for the function.
        kwargs: as for :class:`torchmetrics.Metric`.

    >>> import torch
    >>> metric = ObjectsAndPartsMetric()
    >>> metric.update(torch.tensor([0, 0, 1, 1]), torch.tensor([5, 5, 5, 5]))
    >>> metric.update(torch.tensor([0, 0, 1, 1]), torch.tensor([5, 5, 6, 6]))
    >>> metric.compute()
    ObjectsAndParts(precision=0.55, recall=1.0, f=0.5909090909090909)
    """

    _function = staticmethod(objects_and_parts)

    def __init__(self, gamma_object: float = 0.75, gamma_part: float = 0.25, beta: float = 0.1, **kwargs: Any) -> None:
        check_thresholds(gamma_object, gamma_part, beta)
        options = gamma_object, gamma_part, beta
        super().__init__(num_values=len(ObjectsAndParts._fields), options=options, **kwargs)

    def compute(self) -> ObjectsAndParts:
        """Returns means over the samples. ValueError without a sample."""
        return ObjectsAndParts(*self._mean().tolist())


class _SampleMeanOfOne(_SampleMean):
    """A metric with a single number as its value."""

    def compute(self) -> Tensor:
        """Returns the mean over the samples, a float64 number. ValueError without a sample."""
        return self._mean()[0]


class MeanBestIoUMetric(_SampleMeanOfOne):
    """:func:`torchjoint.metrics.mean_best_iou`, averaged over samples."""

    _function = staticmethod(mean_best_iou)


class AveragePrecisionObjectsMetric(_SampleMeanOfOne):
    """:func:`torchjoint.metrics.average_precision_objects`, averaged over samples.

    Args:
        gamma_part, beta: as for the function.
        kwargs: as for :class:`torchmetrics.Metric`.
    """

    _function = staticmethod(average_precision_objects)

    def __init__(self, gamma_part: float = 0.25, beta: float = 0.1, **kwargs: Any) -> None:
        check_thresholds(0.5, gamma_part, beta)
        super().__init__(options=(gamma_part, beta), **kwargs)


class AveragePrecisionPartsMetric(_SampleMeanOfOne):
    """:func:`torchjoint.metrics.average_precision_parts`, averaged over samples.

    Args:
        gamma_object, beta: as for the function.
        kwargs: as for :class:`torchmetrics.Metric`.
    """

    _function = staticmethod(average_precision_parts)

    def __init__(self, gamma_object: float = 0.75, beta: float = 0.1, **kwargs: Any) -> None:
        check_thresholds(gamma_object, 0.7, beta)
        super().__init__(options=(gamma_object, beta), **kwargs)


class AchievableSegmentationAccuracyMetric(_SampleMeanOfOne):
    """:func:`torchjoint.metrics.achievable_segmentation_accuracy`, averaged over samples."""

    _function = staticmethod(achievable_segmentation_accuracy)


class UndersegmentationErrorMetric(_SampleMeanOfOne):
    """:func:`torchjoint.metrics.undersegmentation_error`, averaged over samples."""

    higher_is_better = False
    _function = staticmethod(undersegmentation_error)


class BoundaryRecallMetric(_SampleMeanOfOne):
    """:func:`torchjoint.metrics.boundary_recall`, averaged over samples.

    Args:
        tolerance: as for the function.
        kwargs: as for :class:`torchmetrics.Metric`.
    """

    def __init__(self, tolerance: int = 1, **kwargs: Any) -> None:
        check_tolerance(tolerance)
        super().__init__(options=(tolerance,), **kwargs)
        self.tolerance = tolerance

    def update(self, pred: Tensor, target: Tensor | Sequence[Tensor], edge_index: Tensor) -> None:  # type: ignore[override]
        """Adds one sample: labels of N points, and the graph [2, E] of the points."""
        self._add(boundary_recall(pred, target, edge_index, tolerance=self.tolerance))
