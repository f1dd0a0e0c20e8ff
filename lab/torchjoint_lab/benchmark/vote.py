"""Votes image segmentations onto the points and merges them over the views: a baseline without a joint method."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from torchjoint.views.visibility import Visible


def vote(label_images: Sequence[Tensor], visible: Sequence[Visible], points: Tensor, share: float = 0.5) -> Tensor:
    """Labels points from independent segmentations of images.

    Processes view after view. A segment inherits the most frequent label of its labelled points, if at least `share` of
    these points have this label; otherwise the segment gets a new label. The segment then labels its unlabelled points.
    A point that no image sees gets the label of the nearest labelled point.

    Args:
        label_images: [H, W] each, with independent ids; -1 = none.
        visible: the points that each image sees.
        points: [N, 3].
        share: in [0, 1].

    Returns:
        [N] int64; all 0 if no image labels any point.
    """
    labels = torch.full((len(points),), -1)
    free = 0
    for image, seen in zip(label_images, visible, strict=True):
        segment = image[seen.row, seen.column]
        inside = segment >= 0
        segment, point = torch.unique(segment[inside], return_inverse=True)[1], seen.point[inside]
        if point.numel() == 0:
            continue
        names = _inherited(segment, labels[point], share)
        new = torch.nonzero(names < 0).flatten()
        names[new] = free + torch.arange(len(new))
        free += len(new)
        labels[point] = torch.where(labels[point] < 0, names[segment], labels[point])
    return fill(labels, points)


def _inherited(segment: Tensor, labels: Tensor, share: float) -> Tensor:
    """Per segment the label that at least `share` of its labelled points have (ties: the lower label), or -1."""
    names = torch.full((int(segment.max()) + 1,), -1)
    known = labels >= 0
    if not known.any():
        return names
    width = int(labels.max()) + 1
    total = torch.bincount(segment[known], minlength=len(names))
    key, count = torch.unique(segment[known] * width + labels[known], return_counts=True)
    enough = count >= share * total[key // width]
    key, count = key[enough].flip(0), count[enough].flip(0)  # of equal counts, the lower label comes last
    order = torch.argsort(count, stable=True)
    for winner in key[order].tolist():  # of several entries of a segment, the last one stays
        names[winner // width] = winner % width
    return names


def fill(labels: Tensor, points: Tensor) -> Tensor:
    """Fills gaps (-1) in labels [N] with the label of the nearest labelled point [N, 3]; all 0 without labels."""
    known = labels >= 0
    if not known.any():
        return torch.zeros_like(labels)
    if not known.all():
        from scipy.spatial import cKDTree

        index = cKDTree(points[known].double().numpy()).query(points[~known].double().numpy())[1]
        labels[~known] = labels[known][torch.from_numpy(index)]
    return labels
