"""A state that all torchmetrics classes of the package share."""

from __future__ import annotations

import torch
from torchmetrics import Metric


def add_options_state(metric: Metric, *options: float) -> None:
    """Adds a state that is equal only for metrics of the same class and options.

    A :class:`torchmetrics.MetricCollection` groups metrics whose states have equal names and values after the first
    update, and then updates only one metric per group. Without this state a perfect sample would group other metrics.
    """
    metric.add_state(
        f"options_of_{type(metric).__name__}", torch.tensor([0.0, *options], dtype=torch.float64), dist_reduce_fx="max"
    )
