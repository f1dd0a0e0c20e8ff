"""Step 6, method regions: the images' evidence for pairs of small superpoints, beside that for single edges.

The two ends of an edge are often closer than the errors of poses and depths. Then an image sees both ends on the same
side of a boundary. Superpoints are larger than these errors. Here superpoints take the place of the windows in eq. 5;
eq. 6 is unchanged.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from scipy.sparse import csr_matrix
from torch import Tensor

from torchjoint.runtime.threads import parallel_map
from torchjoint.views.observations import Observation
from torchjoint.views.propagation import disagreement, round_overlaps

#: An image counts for a superpoint only if it sees at least this many points of the superpoint.
MIN_POINTS = 3
#: Number of images whose overlaps are held in memory at a time.
BATCH = 32


def superpoint_disagreement(
    superpoint: Tensor, edge_index: Tensor, observations: Sequence[Observation], threshold: float
) -> Tensor:
    """The images' disagreement r between the two superpoints that each edge connects (eq. 6); 0 within a superpoint.

    Args:
        superpoint: [N] int64, superpoint of each point, 0 ... K - 1.
        edge_index: [2, E] int64.
        observations: the frames.
        threshold: r_o, the overlap at which an image is neutral.

    Returns:
        [E] float32 in [0, 1]; 1 - r_o if no image sees both superpoints.
    """
    num_superpoints = int(superpoint.max()) + 1
    ends = superpoint[edge_index]
    low, high = ends.amin(0), ends.amax(0)
    across = low < high
    pair, of_pair = torch.unique(low[across] * num_superpoints + high[across], return_inverse=True)
    pairs = torch.stack([pair // num_superpoints, pair % num_superpoints])
    views = torch.zeros(len(pair), dtype=torch.int64)
    overlap_sum = torch.zeros(len(pair), dtype=torch.float64)
    for start in range(0, len(observations), BATCH):
        batch = observations[start : start + BATCH]
        for index, overlap in parallel_map(lambda seen: _overlaps(superpoint, num_superpoints, pairs, seen), batch):
            views[index] += 1
            overlap_sum[index] += overlap
    r = torch.zeros(edge_index.shape[1], dtype=torch.float32)
    r[across] = disagreement(views, overlap_sum, threshold)[of_pair]
    return r


def _overlaps(superpoint: Tensor, num_superpoints: int, pairs: Tensor, seen: Observation) -> tuple[Tensor, Tensor]:
    """Of one image: the pairs of superpoints that it sees, [S] int64, and their overlaps (eq. 5), [S] float64.

    The overlap is the histogram intersection divided by the size of the smaller superpoint, in points that the image
    sees.
    """
    point, label = seen.labelled_points()
    there = superpoint[point]
    shape = (num_superpoints, int(label.max()) + 1 if label.numel() else 1)
    # csr_matrix adds the values of equal (row, column) places.
    counts = csr_matrix((torch.ones_like(label).numpy(), (there.numpy(), label.numpy())), shape)
    size = torch.bincount(there, minlength=num_superpoints)
    smaller = torch.minimum(size[pairs[0]], size[pairs[1]])
    index = torch.nonzero(smaller >= MIN_POINTS).squeeze(1)
    first, second = pairs[:, index].numpy()
    common = torch.from_numpy(counts[first].minimum(counts[second]).sum(1)).view(-1)
    overlap = common.double() / smaller[index]
    return index, round_overlaps(overlap)
