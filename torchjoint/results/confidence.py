"""How sure a level of a hierarchy is of each segment (output after step 8)."""

from __future__ import annotations

import torch
from torch import Tensor

from torchjoint.scene import Hierarchy


def confidence(hierarchy: Hierarchy, height: float) -> Tensor:
    """The margin of each segment of a level, 0 to 1: how far the level can move until the segment changes, both ways.

    It is the height at which the segment joins its surroundings (1 if it never does), minus the height of the last
    merge inside it (0 for a single piece).

    Args:
        hierarchy: all levels.
        height: of the level.

    Returns:
        [P] float64, for the segment of each piece.
    """
    segment = hierarchy.segments_of_pieces(height)
    count = int(segment.max()) + 1
    done = hierarchy.heights <= height
    inner = torch.zeros(count, dtype=torch.float64)
    inner.scatter_reduce_(0, segment[hierarchy.merges[done, 0]], hierarchy.heights[done], "amax")
    # A segment's first merge with another is the lowest of the merges that touch it: heights never fall.
    outer = torch.ones(count, dtype=torch.float64)
    ends = segment[hierarchy.merges[~done]].reshape(-1)
    outer.scatter_reduce_(0, ends, hierarchy.heights[~done].repeat_interleave(2), "amin")
    return (outer - inner)[segment]
