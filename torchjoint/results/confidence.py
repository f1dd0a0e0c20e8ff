"""The confidence of a hierarchy's level in each of its segments (output after step 8)."""

from __future__ import annotations

import torch
from torch import Tensor

from torchjoint.scene import Hierarchy


def confidence(hierarchy: Hierarchy, height: float) -> Tensor:
    """The range of heights, 0 to 1, over which each segment of a level stays the same.

    It is the height at which the segment merges with another (1 if it never does), minus the height of the last merge
    inside it (0 for a single piece).

    Args:
        hierarchy: all levels.
        height: of the level.

    Returns:
        [P] float64: for each piece, the confidence of its segment.
    """
    segment = hierarchy.segments_of_pieces(height)
    count = int(segment.max()) + 1
    done = hierarchy.heights <= height
    inner = torch.zeros(count, dtype=torch.float64)
    inner.scatter_reduce_(0, segment[hierarchy.merges[done, 0]], hierarchy.heights[done], "amax")
    # Heights never fall, so a segment's first merge with another is the lowest merge that touches it.
    outer = torch.ones(count, dtype=torch.float64)
    ends = segment[hierarchy.merges[~done]].reshape(-1)
    outer.scatter_reduce_(0, ends, hierarchy.heights[~done].repeat_interleave(2), "amin")
    return (outer - inner)[segment]
