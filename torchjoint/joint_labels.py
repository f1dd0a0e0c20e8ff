"""Step 8: one id space for points and pixels."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

import torch
from torch import Tensor

from torchjoint.state import Observation
from torchjoint.visibility import Visible


def joint_labels(
    labels: Tensor, visible: Visible, point_labels: Tensor, segment_sizes: Tensor, first_free: int
) -> tuple[Tensor, int]:
    """Names each image segment by the 3D segment most of its points are of (step 8).

    Ties go to the larger 3D segment, then to the lower id. Segments that no point falls in keep ids of their own,
    numbered from `first_free` by first appearance.

    Args:
        labels: [H, W] int64, -1 = none (stays so).
        point_labels: [M] int64, 3D label of each visible point.
        segment_sizes: [S] int64, number of points of each 3D segment.

    Returns:
        ([H, W] int64, the next free id).
    """
    segment = labels[visible.row, visible.column]
    inside = segment >= 0
    num_points = segment_sizes.shape[0]
    key, votes = torch.unique(segment[inside] * num_points + point_labels[inside], return_counts=True)
    segment, winner = key // num_points, key % num_points
    # By segment, then votes, then size, then the lower id: stable sorts by the last criterion first (ids ascend).
    order = torch.arange(key.shape[0])
    for criterion in (-segment_sizes[winner], -votes, segment):
        order = order[torch.argsort(criterion[order], stable=True)]
    best = order[starts_group(segment[order])]
    names = torch.full((int(labels.max()) + 1,), -1)
    names[segment[best]] = winner[best]
    return _number_rest(labels, names, first_free)


def separate_private_ids(
    refined: Sequence[tuple[Tensor, int]], observations: Sequence[Observation], num_segments: int
) -> list[Tensor]:
    """Makes ids >= num_segments unique over all images, counting in the order of the frames' names.

    The names' order (and among equal names that of the content), and not that in which frames came, so that the
    latter does not change labels.
    """

    def key(index: int) -> tuple[str, bytes]:
        seen = observations[index]
        return seen.name, hashlib.sha256(seen.labels.numpy().tobytes() + seen.image.numpy().tobytes()).digest()

    images = [labels for labels, _ in refined]
    offset = 0
    for index in sorted(range(len(refined)), key=key):
        labels, next_free = refined[index]
        images[index] = torch.where(labels >= num_segments, labels + offset, labels)
        offset += next_free - num_segments
    return images


def starts_group(sorted_values: Tensor) -> Tensor:
    """[n] bool: True where a value differs from the one before it."""
    starts = torch.ones_like(sorted_values, dtype=torch.bool)
    starts[1:] = sorted_values[1:] != sorted_values[:-1]
    return starts


def _number_rest(labels: Tensor, names: Tensor, first_free: int) -> tuple[Tensor, int]:
    """Gives the segments that have no name yet ids of their own, by first appearance."""
    flat = labels.reshape(-1)
    first_pixel = torch.full((names.shape[0],), flat.shape[0])
    used = flat >= 0
    first_pixel.scatter_reduce_(0, flat[used], torch.nonzero(used).squeeze(1), "amin")
    unnamed = torch.nonzero((names < 0) & (first_pixel < flat.shape[0])).squeeze(1)
    unnamed = unnamed[torch.argsort(first_pixel[unnamed])]
    names[unnamed] = first_free + torch.arange(unnamed.shape[0])
    named = torch.where(used, names[flat.clamp(min=0)], -1) if names.numel() else flat
    return named.view_as(labels), first_free + unnamed.shape[0]
