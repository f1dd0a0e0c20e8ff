"""Step 6, regions: what the images say about small pieces of the cloud, besides what they say about its edges.

The ends of an edge are often no farther apart than poses and depths are wrong, so that an image sees both on one side
of a border. Pieces are larger than that: they are the windows of eq. 5 here, and eq. 6 stays as it is.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from scipy.sparse import csr_matrix
from torch import Tensor

from torchjoint.config import PropagationConfig
from torchjoint.runtime.threads import parallel_map
from torchjoint.views.observation import Observation
from torchjoint.views.propagation import disagreement, round_overlaps

#: Points of a piece that an image must see to have a say.
MIN_POINTS = 3
#: Images whose overlaps are held in memory at a time.
BATCH = 32


def piece_disagreement(
    piece: Tensor, edge_index: Tensor, observations: Sequence[Observation], config: PropagationConfig
) -> Tensor:
    """The images' disagreement r between the pieces that each edge joins (eq. 6); 0 within a piece.

    Args:
        piece: [N] int64 of the points, 0 ... K - 1.
        edge_index: [2, E].

    Returns:
        [E] float32 in [0, 1]; 1 - r_o where no image sees both pieces.
    """
    num_pieces = int(piece.max()) + 1
    ends = piece[edge_index]
    low, high = ends.amin(0), ends.amax(0)
    across = low < high
    pair, of_pair = torch.unique(low[across] * num_pieces + high[across], return_inverse=True)
    pairs = torch.stack([pair // num_pieces, pair % num_pieces])
    views = torch.zeros(len(pair), dtype=torch.int64)
    overlap_sum = torch.zeros(len(pair), dtype=torch.float64)
    for start in range(0, len(observations), BATCH):
        batch = observations[start : start + BATCH]
        for index, overlap in parallel_map(lambda seen: _overlaps(piece, num_pieces, pairs, seen), batch):
            views[index] += 1
            overlap_sum[index] += overlap
    r = torch.zeros(edge_index.shape[1])
    r[across] = disagreement(views, overlap_sum, len(observations), config)[of_pair]
    return r


def _overlaps(piece: Tensor, num_pieces: int, pairs: Tensor, seen: Observation) -> tuple[Tensor, Tensor]:
    """One image's part: which pairs of pieces it sees, [S] int64, and their overlap (eq. 5), [S] float64.

    Overlap is histogram intersection over the size of the smaller piece, counted in points that the image sees.
    """
    point, label = seen.labelled_points()
    there = piece[point]
    shape = (num_pieces, int(label.max()) + 1 if label.numel() else 1)
    # Equal places are added up.
    counts = csr_matrix((torch.ones_like(label).numpy(), (there.numpy(), label.numpy())), shape)
    size = torch.bincount(there, minlength=num_pieces)
    smaller = torch.minimum(size[pairs[0]], size[pairs[1]])
    index = torch.nonzero(smaller >= MIN_POINTS).squeeze(1)
    first, second = pairs[:, index].numpy()
    common = torch.from_numpy(counts[first].minimum(counts[second]).sum(1)).view(-1)
    overlap = common.double() / smaller[index]
    return index, round_overlaps(overlap)
