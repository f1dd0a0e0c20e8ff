"""What the states of the torchmetrics classes have in common."""

from __future__ import annotations

import torch
from torchmetrics import Metric


def tell_apart(metric: Metric, *options: float) -> None:
    """Adds a state that only metrics of the same class and options share.

    A :class:`torchmetrics.MetricCollection` updates only one of the metrics whose states have the same names and values
    after the first update: after a perfect sample that would be measures that have nothing else in common.
    """
    metric.add_state(
        f"options_of_{type(metric).__name__}", torch.tensor([0.0, *options], dtype=torch.float64), dist_reduce_fx="max"
    )
