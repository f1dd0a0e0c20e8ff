"""Step 6, method learned: what the images see of the pieces of the cloud and of the edges between them.

All sums over frames are of whole numbers. So the order of the frames does not change a single bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint.runtime.threads import parallel_map
from torchjoint.views.observation import Observation

#: Number of images whose results are held in memory at a time.
BATCH = 32
#: Where the boundary strength is read on the line between the pixels of an edge's two ends, 0 = first end, 1 = second.
STEPS = (0.0, 0.25, 0.5, 0.75, 1.0)


class ImageEvidence(NamedTuple):
    """How many points of each piece lie in each segment of each image: I pairs (piece, image segment) with points.

    The segments of all images have different numbers, 0 ... L - 1, those of one image consecutive ones.
    """

    piece: Tensor  #: [I] int32
    segment: Tensor  #: [I] int32, those of one frame after those of the frame before
    num_points: Tensor  #: [I] int32, visible points of the piece in the segment
    segment_size: Tensor  #: [L] int64, visible points in the segment
    frame_of_segment: Tensor  #: [L] int64
    num_frames: int


def segments_of_pieces(piece: Tensor, observations: Sequence[Observation]) -> ImageEvidence:
    """Counts the visible points of each piece in each image segment.

    Args:
        piece: [N] int64, piece of each point, 0 ... P - 1.
        observations: the frames, at least one.
    """

    def count_points(seen: Observation) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        point, label = seen.labelled_points()
        num_labels = int(label.max()) + 1 if label.numel() else 0
        pair, count = torch.unique(piece[point] * num_labels + label, return_counts=True)
        of_pair = (pair // max(num_labels, 1), pair % max(num_labels, 1), count)
        return *(values.int() for values in of_pair), torch.bincount(label, minlength=num_labels)

    pieces, labels, counts, sizes = zip(*parallel_map(count_points, observations), strict=True)
    num_labels = torch.tensor([len(size) for size in sizes])
    first = num_labels.cumsum(0) - num_labels
    return ImageEvidence(
        torch.cat(pieces),
        torch.cat([label + start for label, start in zip(labels, first.tolist(), strict=True)]),
        torch.cat(counts),
        torch.cat(sizes),
        torch.repeat_interleave(torch.arange(len(sizes)), num_labels),
        len(sizes),
    )


def contours_across(edge_index: Tensor, num_points: int, observations: Sequence[Observation]) -> tuple[Tensor, Tensor]:
    """The strength of the images' boundaries between the two ends of each edge, mean over the images that see both.

    In one image it is the largest boundary strength on the line between the two ends.

    Args:
        edge_index: [2, C] int64.
        num_points: N.
        observations: the frames.

    Returns:
        [C] float32 in [0, 1], NaN if no image sees both ends; and [C] int64, the number of images that do.
    """

    def strongest(seen: Observation) -> tuple[Tensor, Tensor]:
        visible = seen.visible
        place = torch.full((num_points,), -1, dtype=torch.int32)
        place[visible.point] = torch.arange(len(visible.point), dtype=torch.int32)
        first, second = place[edge_index[0]], place[edge_index[1]]
        edges = torch.nonzero((first >= 0) & (second >= 0)).squeeze(1)
        first, second = first[edges].long(), second[edges].long()
        width = seen.boundary.shape[1]
        boundary = seen.boundary.reshape(-1)
        ends = [(values[first], values[second]) for values in (visible.row, visible.column)]
        strength = torch.zeros(len(edges), dtype=torch.uint8)
        for step in STEPS:
            row, column = ((one * (1 - step) + other * step).round().long() for one, other in ends)
            strength = torch.maximum(strength, boundary[row * width + column])
        return edges, strength

    total = torch.zeros(edge_index.shape[1], dtype=torch.int64)
    views = torch.zeros_like(total)
    for start in range(0, len(observations), BATCH):
        for edges, strength in parallel_map(strongest, observations[start : start + BATCH]):
            total[edges] += strength
            views[edges] += 1
    return torch.where(views > 0, total / (255 * views.clamp(min=1)), torch.nan), views
