"""Step 6, method learned, with masks of a network: moves a point to the region in which most frames see it.

Pieces are small, but geometry does not show all borders of objects, so a piece may reach a little across a border. All
frames together show on which side of the border a single point lies.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from torchjoint.runtime.threads import parallel_map
from torchjoint.scene import Hierarchy
from torchjoint.segments.learned.mask_counts import MaskCounts
from torchjoint.segments.learned.mask_merging import overlaps
from torchjoint.views.observation import Observation

#: Number of frames whose points are held in memory at a time.
BATCH = 32


def move_to_majority(
    hierarchy: Hierarchy, edge_index: Tensor, masks: MaskCounts, observations: Sequence[Observation]
) -> Hierarchy:
    """Moves points to the regions of the masks in which most frames see them.

    Each mask belongs to the region of the default level with which it overlaps best. A point moves if more than half of
    the frames with masks that see it show it in masks of one other region, and if it has a neighbour in that region.
    It joins the piece of this neighbour; if there are several, the one with the lowest number counts. So all levels
    stay nested. No piece loses all its points.

    Args:
        hierarchy: the pieces and their merges.
        edge_index: [2, E] int64, edges of the point graph.
        masks: the masks in which the pieces lie.
        observations: the frames from which `masks` was made.
    """
    of_piece = hierarchy.segments_of_pieces(hierarchy.default)
    region = of_piece[hierarchy.piece]
    wanted = _wanted_regions(region, _best_regions(masks, of_piece), observations)
    ends = torch.cat([edge_index, edge_index.flip(0)], 1)
    one, other = ends[:, (wanted[ends[0]] >= 0) & (wanted[ends[0]] == region[ends[1]])]
    num_points = len(region)
    source = torch.full((num_points,), num_points).scatter_reduce_(0, one, other, "amin")
    stays = torch.arange(num_points)
    source = torch.where(source < num_points, source, stays)
    # If points stay to keep their piece, another piece that would have received them may be lost: test again.
    while (is_lost := torch.bincount(hierarchy.piece[source], minlength=hierarchy.num_pieces) == 0).any():
        source = torch.where(is_lost[hierarchy.piece], stays, source)
    return hierarchy.transferred(source)[0]


def _wanted_regions(region: Tensor, region_of_mask: Tensor, observations: Sequence[Observation]) -> Tensor:
    """For each point, another region in whose masks more than half of its frames show it: [N] int64, -1 = none.

    Args:
        region: [N] int64, region of each point, 0 ... R - 1.
        region_of_mask: [M] int64, -1 = none; the masks are numbered frame by frame.
        observations: the frames; those without masks do not count.
    """
    num_regions = int(region.max()) + 1
    views, first = torch.zeros_like(region), 0
    votes = [torch.empty(0, dtype=torch.int64)]
    for start in range(0, len(observations), BATCH):
        for point, mask, num_masks in parallel_map(_smallest_masks, observations[start : start + BATCH]):
            views[point] += 1
            point, chosen = point[mask >= 0], region_of_mask[first + mask[mask >= 0]]
            elsewhere = (chosen >= 0) & (chosen != region[point])
            votes.append(point[elsewhere] * num_regions + chosen[elsewhere])
            first += num_masks
    key, count = torch.unique(torch.cat(votes), return_counts=True)
    most = 2 * count > views[key // num_regions]  # so at most one region per point
    wanted = torch.full_like(region, -1)
    wanted[key[most] // num_regions] = key[most] % num_regions
    return wanted


def _smallest_masks(seen: Observation) -> tuple[Tensor, Tensor, int]:
    """The visible points [V], the smallest mask in which each lies, -1 = none, and the number of masks of the frame."""
    if seen.masks is None:
        nothing = torch.empty(0, dtype=torch.int64)
        return nothing, nothing, 0
    smallest = seen.masks.smallest(torch.ones(len(seen.masks), dtype=torch.bool))
    visible = seen.visible
    return visible.point, smallest[seen.masks.atom[visible.row, visible.column].long()], len(seen.masks)


def _best_regions(masks: MaskCounts, of_piece: Tensor) -> Tensor:
    """The region that overlaps best with each mask, of several the lowest: [M] int64, -1 = none."""
    in_mask, in_frame = masks.of_regions(of_piece)
    region, mask, _ = in_mask
    overlap, num_masks = overlaps(masks, in_mask, in_frame), len(masks.weight)
    largest = torch.zeros(num_masks, dtype=torch.float64).scatter_reduce_(0, mask, overlap, "amax")
    is_largest = overlap == largest[mask]
    none = int(of_piece.max()) + 1
    best = torch.full((num_masks,), none).scatter_reduce_(0, mask[is_largest], region[is_largest], "amin")
    return torch.where(best < none, best, -1)
