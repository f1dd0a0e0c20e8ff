"""Clustering of masks by the consensus of views: MaskClustering.

M. Yan, J. Zhang, Y. Zhu, H. Wang, "MaskClustering: View Consensus based Mask Graph Clustering for Open-Vocabulary 3D
Instance Segmentation" (CVPR 2024). Written from the paper, not from its code.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from scipy import sparse
from torch import Tensor

from torchjoint import ops
from torchjoint.scene.masks import Masks
from torchjoint.views.visibility import Visible
from torchjoint_lab.benchmark.mask_merging.sightings import Array, Sightings, sightings
from torchjoint_lab.benchmark.vote import fill

#: A frame observes a mask if it sees at least this share of the mask's points.
VISIBLE = 0.3
#: A mask contains another if at least this share of the visible points of the other lies in it.
CONTAINED = 0.8
#: A mask is undersegmented if more than this share of the frames that see it split it. (0.3 and 0.5 made the method
#: worse on generated rooms, tables and shelves with masks that are often split.)
UNDERSEGMENTED = 0.8
#: Smallest view consensus rate of two masks of one object.
CONSENSUS = 0.9


def mask_clustering(
    points: Tensor,
    visible: Sequence[Visible],
    masks: Sequence[Masks],
    superpoints: Tensor | None = None,
    consensus: float = CONSENSUS,
) -> Tensor:
    """Clusters masks that other views show as one.

    A frame observes a mask if it sees enough of it, and one of its masks contains what it sees; otherwise it splits the
    mask. Masks that most frames split are undersegmented, and left out. Two masks have a view consensus rate: of the
    frames that observe both, the share in which one mask contains both. Masks with a rate of `consensus` or more form a
    cluster, in rounds: first only pairs with many observers, then pairs with fewer. A cluster is observed and contained
    wherever one of its masks is. Clusters of one mask are left out, unless there are no others. A point gets the
    cluster with most masks on it. Each point needs a label here: points without one take that of the nearest point, and
    the paper's removal of points is left out. Tables of all pairs of masks are dense in memory.

    Args:
        points: [N, 3] metres.
        visible: per frame the points that it sees.
        masks: per frame the masks.
        superpoints: not used.
        consensus: smallest rate of masks of one object.

    Returns:
        [N] int64 labels.
    """
    seen = sightings(len(points), visible, masks)
    inside = seen.points_by_masks()
    visible_in, contained = _relations(seen, inside)
    observed = np.zeros_like(visible_in)
    row, column = contained.nonzero()
    observed[row, seen.frame_of_mask[column]] = True
    is_split = (visible_in & ~observed).sum(axis=1) > UNDERSEGMENTED * visible_in.sum(axis=1)
    kept = np.flatnonzero(~is_split & observed.any(axis=1))
    if len(kept) == 0:
        return torch.zeros(len(points), dtype=torch.int64)
    contained = contained[kept][:, kept]
    cluster = _clusters(observed[kept], contained, seen.frame_of_mask[kept], consensus)
    confirmed = np.bincount(cluster)[cluster] > 1
    of_mask = np.full(len(seen.frame_of_mask), -1)
    of_mask[kept] = np.where(confirmed | ~confirmed.any(), cluster, -1)
    labels = _points_of(inside, of_mask)
    return fill(torch.from_numpy(labels), points)


def _relations(seen: Sightings, inside: sparse.csr_array) -> tuple[Array, sparse.csr_array]:
    """Which frames see enough of each mask, [M, T] bool, and which masks contain it, [M, M], sparse.

    A frame in which most visible points of a mask have no mask says nothing about it, and does not count.
    """
    size = np.asarray(inside.sum(axis=0)).reshape(-1)
    in_frame = (inside.T @ seen.points_by_frames()).toarray()
    shared = (inside.T @ inside).tocoo()
    row, column = shared.coords
    in_masks = np.zeros_like(in_frame)
    np.add.at(in_masks, (row, seen.frame_of_mask[column]), shared.data)
    enough = (in_frame >= VISIBLE * np.maximum(size, 1)[:, None]) & (2 * in_masks >= in_frame) & (in_frame > 0)
    frame = seen.frame_of_mask[column]
    contains = (shared.data >= CONTAINED * in_frame[row, frame]) & enough[row, frame]
    ones = np.ones(int(contains.sum()), dtype=np.float32)
    return enough, sparse.csr_array((ones, (row[contains], column[contains])), shared.shape)


def _clusters(observed: Array, contained: sparse.csr_array, frame_of_mask: Array, consensus: float) -> Array:
    """[M] the cluster of each mask; clusters grow in rounds with fewer and fewer observers."""
    cluster = np.arange(len(observed))
    seen, within = observed.astype(np.float32), contained
    for least in _numbers_of_observers(seen):
        together = seen @ seen.T
        support = np.zeros_like(together)
        for frame in np.unique(frame_of_mask):
            of_frame = within[:, frame_of_mask == frame]
            support += ((of_frame @ of_frame.T) > 0).toarray()
        merge = (together >= least) & (support >= consensus * together)
        group = ops.connected_components(torch.from_numpy(np.stack(merge.nonzero())), len(merge)).numpy()
        members = sparse.csr_array((np.ones(len(group), dtype=np.float32), (group, np.arange(len(group)))))
        seen = ((members @ seen) > 0).astype(np.float32)
        within = ((members @ within) > 0).astype(np.float32)
        cluster = group[cluster]
    return cluster


def _numbers_of_observers(seen: Array) -> list[float]:
    """The smallest number of observers of each round: the 95th, 90th, ... percentile over the pairs, down to 1."""
    together = np.triu(seen @ seen.T, 1)
    numbers = together[together > 0]
    if len(numbers) == 0:
        return []
    percentiles = np.percentile(numbers, np.arange(95, -1, -5))
    return [*dict.fromkeys(float(number) for number in percentiles if number > 1), 1.0]


def _points_of(inside: sparse.csr_array, of_mask: Array) -> Array:
    """[N] the cluster with most masks on each point (ties: the lower one), -1 = none."""
    kept = np.flatnonzero(of_mask >= 0)
    ones = np.ones(len(kept), dtype=np.float32)
    to_cluster = sparse.csr_array((ones, (kept, of_mask[kept])), (len(of_mask), int(of_mask.max()) + 1))
    votes = (inside @ to_cluster).tocoo()
    point, cluster = votes.coords
    order = np.lexsort((-cluster, votes.data, point))  # of several entries of a point, the last one stays
    labels = np.full(inside.shape[0], -1)
    labels[point[order]] = cluster[order]
    return labels
