"""Step 8: one id space for points and pixels."""

import hashlib
from collections import Counter
from collections.abc import Sequence

import torch
from torch import Tensor

from torchjoint.runtime.groups import counted_pairs, starts_group
from torchjoint.views.observations import Observations
from torchjoint.views.visibility import Visible


def by_first_appearance(labels: Tensor, wanted: Tensor) -> Tensor:
    """The wanted labels ([K] bool) that occur in an image [H, W], in the order of their first pixels; [L] int64."""
    pixel = torch.nonzero(look_up(wanted, labels, False).view(-1)).squeeze(1)
    first_pixel = torch.full((wanted.shape[0],), labels.numel())
    first_pixel.scatter_reduce_(0, labels.reshape(-1)[pixel].long(), pixel, "amin")
    found = torch.nonzero(first_pixel < labels.numel()).squeeze(1)
    return found[torch.argsort(first_pixel[found])]


def look_up(table: Tensor, labels: Tensor, none: float) -> Tensor:
    """``table[labels]``, and `none` where a label is -1; several times faster than indexing."""
    table = torch.cat([table.new_full((1,), none), table])
    return table.index_select(0, labels.reshape(-1) + 1).view(labels.shape)


def joint_labels(
    labels: Tensor, visible: Visible, point_labels: Tensor, segment_sizes: Tensor, first_free: int
) -> tuple[Tensor, int]:
    """Gives each image segment the id of the 3D segment to which most of its points belong (step 8).

    Ties go to the larger 3D segment, then to the lower id. Segments without points get their own ids, numbered from
    `first_free` by first appearance.

    Args:
        labels: [H, W] int32, -1 = none (stays -1).
        visible: M visible points.
        point_labels: [M] int64, 3D label of each visible point.
        segment_sizes: [S] int64, number of points of each 3D segment.
        first_free: the first id for segments without points.

    Returns:
        ([H, W] int32, the next free id).
    """
    names = torch.full((int(labels.max()) + 1 if labels.numel() else 0,), -1)
    segment, winner = _most_votes(labels[visible.row, visible.column].long(), point_labels, segment_sizes)
    names[segment] = winner
    unnamed = by_first_appearance(labels, names < 0)
    names[unnamed] = first_free + torch.arange(unnamed.shape[0])
    return look_up(names.to(torch.int32), labels, -1), first_free + unnamed.shape[0]


def _most_votes(segment: Tensor, point_labels: Tensor, segment_sizes: Tensor) -> tuple[Tensor, Tensor]:
    """The image segments that contain points, and for each the 3D segment of most of its points."""
    inside = segment >= 0
    segment, winner, votes = counted_pairs(segment[inside], point_labels[inside])
    # Sort by segment, then votes, then size, then lower id: stable sorts, last criterion first (ids are ascending).
    order = torch.arange(len(segment))
    for criterion in (-segment_sizes[winner], -votes, segment):
        order = order[torch.argsort(criterion[order], stable=True)]
    best = order[starts_group(segment[order])]
    return segment[best], winner[best]


def private_id_offsets(next_free: Sequence[int], observations: Observations, num_segments: int) -> list[int]:
    """The number to add to the ids >= num_segments of each image, so that no such id occurs in two images.

    Ids ascend in the order of the frames' names; frames of equal names are ordered by a hash of their content. The
    order in which frames were added does not change the labels.

    Args:
        next_free: for each frame, the first id after its own ids.
        observations: the frames.
        num_segments: number of 3D segments.
    """
    names = observations.names
    times_named = Counter(names)

    def key(index: int) -> tuple[str, bytes]:
        if times_named[names[index]] == 1:
            return names[index], b""
        seen = observations[index]
        return seen.name, hashlib.sha256(seen.labels.numpy().tobytes() + seen.image.numpy().tobytes()).digest()

    offsets, offset = [0] * len(names), 0
    for index in sorted(range(len(names)), key=key):
        offsets[index] = offset
        offset += next_free[index] - num_segments
    return offsets
