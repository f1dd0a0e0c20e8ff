"""ScanNet's average precision of many scenes, as a module of torchmetrics: it is no mean over scenes."""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor
from torchmetrics import Metric
from torchmetrics.utilities import dim_zero_cat

from torchjoint.metrics.scannet import AveragePrecision, Matches, areas, check_min_size, match_instances


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
    num_scenes: Tensor
    num_instances: Tensor

    def __init__(self, min_size: int = 100, **kwargs: Any) -> None:
        check_min_size(min_size)
        super().__init__(**kwargs)
        self.min_size = min_size
        # A MetricCollection takes metrics for equal whose states are: this one tells options apart.
        self.add_state("least", torch.tensor(min_size), dist_reduce_fx=_of_all)
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

    def merge_state(self, incoming_state: dict[str, Any] | Metric) -> None:
        """Adds the scenes of another one, or of its state. ValueError if its min_size is another."""
        super().merge_state(incoming_state)
        self._computed = None  # torchmetrics would give the value of before

    def compute(self) -> AveragePrecision:
        """Returns the AP of all scenes so far. ValueError without a scene; nan if no instance is large enough."""
        if int(self.num_scenes) == 0:
            raise ValueError(f"{type(self).__name__}: expected an update before compute, got none")
        return areas(Matches(*(dim_zero_cat(getattr(self, name)) for name in Matches._fields)), int(self.num_instances))


def _of_all(least: Tensor) -> Tensor:
    """The min_size that all merged metrics have."""
    if bool((least != least[0]).any()):
        raise ValueError(f"min_size: expected metrics with the same one, got {least.int().tolist()}")
    return least[0]
