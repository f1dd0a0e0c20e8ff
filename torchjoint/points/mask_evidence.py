"""Step 6, method learned: which masks of a network the points of each piece lie in.

All counts are whole numbers, and sums over points. So those of a region are the sums of those of its pieces, and the
order of the frames does not change a single bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint.ops.mask_merges import WEIGHT_UNIT
from torchjoint.runtime.sorted_groups import members_of_groups
from torchjoint.runtime.threads import parallel_map
from torchjoint.views.observation import Observation


class MaskEvidence(NamedTuple):
    """How many points of each piece lie in each mask. The masks of all frames have different numbers, 0 ... M - 1."""

    in_mask: Tensor  #: [3, I] int64: piece, mask, number of points
    in_frame: Tensor  #: [3, J] int64: piece, frame, number of points that the frame sees
    weight: Tensor  #: [M] int64, score of each mask in units of 1 / WEIGHT_UNIT
    frame_of_mask: Tensor  #: [M] int64

    def of_regions(self, of_piece: Tensor) -> tuple[Tensor, Tensor]:
        """`in_mask` and `in_frame` of regions instead of pieces; `of_piece` is the region of each piece, [P] int64."""
        (piece, mask, in_mask), (seen_piece, frame, in_frame) = self.in_mask, self.in_frame
        return _added(of_piece[piece], mask, in_mask), _added(of_piece[seen_piece], frame, in_frame)


def masks_of_pieces(piece: Tensor, observations: Sequence[Observation]) -> MaskEvidence | None:
    """Counts the visible points of each piece in each mask.

    Args:
        piece: [N] int64, piece of each point.
        observations: the frames; those without masks do not count.

    Returns:
        None if no frame has masks.
    """
    tables = [one for one in parallel_map(lambda seen: _count(piece, seen), observations) if one is not None]
    if not tables:
        return None
    num_masks = torch.tensor([len(scores) for _, _, scores in tables])
    first = num_masks.cumsum(0) - num_masks
    in_mask = [
        rows + torch.tensor([[0], [start], [0]]) for (rows, _, _), start in zip(tables, first.tolist(), strict=True)
    ]
    in_frame = [rows + torch.tensor([[0], [frame], [0]]) for frame, (_, rows, _) in enumerate(tables)]
    scores = torch.cat([scores for _, _, scores in tables])
    return MaskEvidence(
        torch.cat(in_mask, 1),
        torch.cat(in_frame, 1),
        (scores.double() * WEIGHT_UNIT).round().long(),
        torch.repeat_interleave(torch.arange(len(tables)), num_masks),
    )


def _count(piece: Tensor, seen: Observation) -> tuple[Tensor, Tensor, Tensor] | None:
    """One frame's rows (piece, mask, points), (piece, 0, points that it sees), and the scores of its masks, if any."""
    if seen.masks is None:
        return None
    visible, masks = seen.visible, seen.masks
    there = piece[visible.point]
    of_piece, num_seen = torch.unique(there, return_counts=True)
    in_frame = torch.stack([of_piece, torch.zeros_like(of_piece), num_seen])
    atom = masks.atom[visible.row, visible.column].long()
    key, count = torch.unique(there * masks.num_atoms + atom, return_counts=True)
    # Each atom counts for all masks in which it lies.
    atoms, mask = masks.pairs[:, torch.argsort(masks.pairs[0], stable=True)]
    row, member = members_of_groups(torch.bincount(atoms, minlength=masks.num_atoms), key % masks.num_atoms)
    return _added(key[row] // masks.num_atoms, mask[member], count[row]), in_frame, masks.scores


def _added(region: Tensor, key: Tensor, count: Tensor) -> Tensor:
    """The sorted rows [3, K] of (region, key, count), where the counts of equal region and key are added."""
    num_keys = int(key.max()) + 1 if key.numel() else 1
    pair, inverse = torch.unique(region * num_keys + key, return_inverse=True)
    total = torch.zeros_like(pair).index_add_(0, inverse, count)
    return torch.stack([pair // num_keys, pair % num_keys, total])
