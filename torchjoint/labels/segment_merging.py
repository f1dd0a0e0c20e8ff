"""Step 7, method cuts: 3D labels merge segments of an image (eq. 10-12)."""

from __future__ import annotations

import torch
from torch import Tensor

from torchjoint import ops
from torchjoint.config import PaperConfig
from torchjoint.labels._tables import look_up
from torchjoint.labels.pixel_pairs import RADIUS, pixel_pairs
from torchjoint.views.visibility import Visible


def merge_segments(labels: Tensor, visible: Visible, point_labels: Tensor, config: PaperConfig) -> Tensor:
    """Merges image segments whose points mostly have the same 3D labels (eq. 10-12).

    For two segments (unordered), n_R is the number of point pairs with one end in each segment, and n_int the number of
    internal pairs among them. The two merge if n_R > 0 and n_int / n_R >= r_m. All pairs of segments are tested once,
    on the segments as given.

    Args:
        labels: [H, W] int32, -1 = none (never merged).
        visible: M visible points.
        point_labels: [M] int64, 3D label of each visible point.
        config: r_m.

    Returns:
        [H, W] int32; a merged segment has the lowest of its labels.
    """
    if config.merge_ratio is None:
        return labels
    segment = labels[visible.row, visible.column].long()
    pairs = pixel_pairs(visible, segment, point_labels, labels.shape[1], RADIUS)
    pairs = pairs.select(pairs.low_segment != pairs.high_segment)
    if not pairs.num_pairs.numel():
        return labels
    num_labels = int(labels.max()) + 1
    keys, of_key = torch.unique(pairs.low_segment * num_labels + pairs.high_segment, return_inverse=True)
    internal = pairs.num_pairs * (pairs.low_label == pairs.high_label)
    n_all, n_internal = (torch.zeros_like(keys).index_add(0, of_key, counts) for counts in (pairs.num_pairs, internal))
    merging = keys[n_internal / n_all >= config.merge_ratio]
    component = ops.connected_components(torch.stack([merging // num_labels, merging % num_labels]), num_labels)
    lowest = torch.full((num_labels,), num_labels).scatter_reduce(0, component, torch.arange(num_labels), "amin")
    return look_up(lowest[component].to(labels.dtype), labels, -1)
