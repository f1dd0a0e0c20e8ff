"""Image segmentations voted onto the points, and joined over the views: what one does without a joint method."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from torchjoint.views.visibility import Visible


def vote(label_images: Sequence[Tensor], visible: Sequence[Visible], points: Tensor, share: float = 0.5) -> Tensor:
    """Labels of points from segmentations of images that were made one by one.

    View after view: a segment takes over the label that most of its already labelled points have, if that is at least
    `share` of them, and else a new one; it labels the points that have none yet. Points that no image sees get
    the label of the nearest point that has one.

    Args:
        label_images: [H, W] each, ids of their own; -1 = none.
        visible: the points that each image sees.
        points: [N, 3].

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
    """For each segment the label that at least `share` of its labelled points have (ties: the lower), or -1."""
    names = torch.full((int(segment.max()) + 1,), -1)
    known = labels >= 0
    if not known.any():
        return names
    width = int(labels.max()) + 1
    total = torch.bincount(segment[known], minlength=len(names))
    key, count = torch.unique(segment[known] * width + labels[known], return_counts=True)
    enough = count >= share * total[key // width]
    key, count = key[enough].flip(0), count[enough].flip(0)  # of equals the lower label comes last
    order = torch.argsort(count, stable=True)
    for winner in key[order].tolist():  # of each segment the last one stays
        names[winner // width] = winner % width
    return names


def fill(labels: Tensor, points: Tensor) -> Tensor:
    """Labels [N] whose gaps (-1) get the label of the nearest point [N, 3] that has one; all 0 if none has."""
    known = labels >= 0
    if not known.any():
        return torch.zeros_like(labels)
    if not known.all():
        from scipy.spatial import cKDTree

        index = cKDTree(points[known].double().numpy()).query(points[~known].double().numpy())[1]
        labels[~known] = labels[known][torch.from_numpy(index)]
    return labels
