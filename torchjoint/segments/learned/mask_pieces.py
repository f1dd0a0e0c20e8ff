"""Step 6, method learned, with masks of a network: cuts pieces at the outlines of masks.

Geometry and colours do not show all borders of objects, and a piece has a minimum size. So it may contain two small
objects, or an object and a part of its support. Pieces are never split later, so they are cut here.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from torchjoint import ops
from torchjoint.ops.internal import mask_merges
from torchjoint.runtime.first_places import first_places
from torchjoint.segments.learned.mask_counts import MaskCounts, masks_of_pieces
from torchjoint.segments.learned.mask_merging import APART_WEIGHT, shares_against
from torchjoint.views.observation import Observation

# These numbers were chosen on generated rooms, table-tops and shelves with perfect, SAM-like and hard masks. None of
# these scenes is used for scores.

#: A piece is cut if more than this share of the votes of its pairs of points is against one object.
MIXED = 0.1
#: Weight, in frames, of the assumption that the points of one piece belong together.
PRIOR_WEIGHT = 0.1
#: Largest cost of two parts that merge again.
THRESHOLD = 0.5
#: Largest number of frames per piece: those that see most of it. All frames of all points would take gigabytes.
MAX_FRAMES = 32


def cut_by_masks(piece: Tensor, edge_index: Tensor, observations: Sequence[Observation]) -> Tensor:
    """Cuts the pieces whose points lie in different masks.

    The points of such a piece merge again from single points, as regions do
    (:func:`torchjoint.ops.internal.mask_merges`). So a piece is cut only where the masks of most frames agree; single
    wrong outlines do not cut.

    Args:
        piece: [N] int64, 0 ... P - 1.
        edge_index: [2, E] int64, edges of the point graph.
        observations: the frames; those without masks do not count.

    Returns:
        [N] int64 pieces, numbered by first appearance; each lies inside one of the given pieces.
    """
    masks = masks_of_pieces(piece, observations)
    if masks is None:
        return piece
    num_pieces = int(piece.max()) + 1
    is_mixed = shares_against(masks, masks.in_mask, masks.in_frame, num_pieces) > MIXED
    single = is_mixed[piece]
    # The points of mixed pieces are regions of their own; each other piece is one region, named by its first point.
    first = first_places(piece, num_pieces)[piece]
    region = torch.unique(torch.where(single, torch.arange(len(piece)), first), return_inverse=True)[1]
    i, j = edge_index
    ends = region[edge_index[:, single[i] & (piece[i] == piece[j])]]
    counts = _frames_that_see_most(masks.in_frame, num_pieces, len(observations))
    of_points = masks_of_pieces(region, observations, lambda frame, point: counts[frame, piece[point]])
    joined = _merges_of_parts(ends, torch.bincount(region), of_points)
    return ops.connected_components(joined, int(region.max()) + 1)[region]


def _frames_that_see_most(in_frame: Tensor, num_pieces: int, num_frames: int) -> Tensor:
    """The MAX_FRAMES frames that see most points of each piece; ties: the first frames. [F, P] bool."""
    piece, frame, num_points = in_frame[:, torch.argsort(in_frame[1], stable=True)]
    order = torch.argsort(num_points, descending=True, stable=True)
    order = order[torch.argsort(piece[order], stable=True)]
    count = torch.bincount(piece, minlength=num_pieces)
    rank = torch.arange(len(order)) - (count.cumsum(0) - count)[piece[order]]
    chosen = order[rank < MAX_FRAMES]
    most = torch.zeros(num_frames, num_pieces, dtype=torch.bool)
    most[frame[chosen], piece[chosen]] = True
    return most


def _merges_of_parts(edge_index: Tensor, size: Tensor, masks: MaskCounts | None) -> Tensor:
    """The merges [2, M] of regions that the masks do not separate; `size` [R] is their number of points."""
    assert masks is not None  # the observations have masks
    tables = masks.of_regions(torch.arange(len(size)))
    prior = torch.zeros(edge_index.shape[1], dtype=torch.float32)
    return mask_merges(
        edge_index, prior, size, *tables, masks.weight, masks.frame_of_mask, APART_WEIGHT, PRIOR_WEIGHT, THRESHOLD
    )[0]
