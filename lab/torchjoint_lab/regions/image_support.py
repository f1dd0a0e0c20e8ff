"""Step 6, method regions: image support, how well image segments match the segments of the points.

Fragments along boundaries are as small as cups and pens. But a real object is also a segment of some image; a fragment
is not.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from torchjoint.runtime.threads import parallel_map
from torchjoint.views.observations import Observation

#: An image counts for a segment only if it sees at least this many points of the segment.
MIN_POINTS = 3


def best_overlaps(point_labels: Tensor, observations: Sequence[Observation]) -> Tensor:
    """The best overlap of each segment of the points with a segment of an image, over all images.

    The overlap is the intersection over union, counted in points that the image sees.

    Args:
        point_labels: [N] int64, 0 ... S - 1.
        observations: the frames.

    Returns:
        [S] float32 in [0, 1]; 0 if no image sees MIN_POINTS points of the segment.
    """
    num_segments = int(point_labels.max()) + 1
    overlaps = parallel_map(lambda seen: _overlaps(point_labels, seen, num_segments), observations)
    return torch.stack([torch.zeros(num_segments, dtype=torch.float32), *overlaps]).amax(0)


def _overlaps(point_labels: Tensor, seen: Observation, num_segments: int) -> Tensor:
    point, in_image = seen.labelled_points()
    segment = point_labels[point]
    overlap = torch.zeros(num_segments, dtype=torch.float32)
    if not in_image.numel():
        return overlap
    num_labels = int(in_image.max()) + 1
    pair, both = torch.unique(segment * num_labels + in_image, return_counts=True)
    of_segment, of_label = pair // num_labels, pair % num_labels
    num_seen = torch.bincount(segment, minlength=num_segments)
    union = num_seen[of_segment] + torch.bincount(in_image, minlength=num_labels)[of_label] - both
    overlap.scatter_reduce_(0, of_segment, both.float() / union, "amax")
    return torch.where(num_seen >= MIN_POINTS, overlap, 0)
