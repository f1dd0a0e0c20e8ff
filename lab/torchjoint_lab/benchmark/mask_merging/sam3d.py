"""Pairwise merging of clouds that are labelled by their own frame: SAM3D.

Y. Yang, X. Wu, T. He, H. Zhao, X. Liu, "SAM3D: Segment Anything in 3D Scenes" (ICCV Workshops 2023). Written from the
paper, not from its code.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from torchjoint.cloud.neighbors import nearest_neighbors
from torchjoint.scene.masks import Masks
from torchjoint.views.visibility import Visible
from torchjoint_lab.benchmark.mask_merging.sightings import Array, sightings
from torchjoint_lab.benchmark.vote import fill

#: Two groups are one if they share at least this part of the smaller one.
OVERLAP = 0.3
#: Side of the voxels in which points of two clouds correspond, in units of the median spacing of the points.
VOXEL = 2.0


def sam3d(
    points: Tensor,
    visible: Sequence[Visible],
    masks: Sequence[Masks],
    superpoints: Tensor,
    overlap: float = OVERLAP,
) -> Tensor:
    """Labels the points of each frame by its masks, and merges the clouds of adjacent frames, two by two.

    When two clouds merge, each group of one takes the name of the group of the other with which it shares most voxels,
    if it shares at least `overlap` of the smaller group; then the same the other way round. In the end, the points of a
    superpoint take its most frequent label.

    Args:
        points: [N, 3] metres.
        visible: per frame the points that it sees.
        masks: per frame the masks.
        superpoints: [N] int64, 0 ... S - 1.
        overlap: share of the smaller group that two groups of one object have in common.

    Returns:
        [N] int64 labels.
    """
    seen = sightings(len(points), visible, masks).in_masks()
    voxel = _voxels(points)
    clouds = [
        _majority(voxel[seen.point[seen.frame == frame]], seen.mask[seen.frame == frame], int(voxel.max()) + 1)
        for frame in range(seen.num_frames)
    ]
    while len(clouds) > 1:
        pairs = [_merged(clouds[i], clouds[i + 1], overlap) for i in range(0, len(clouds) - 1, 2)]
        clouds = pairs + clouds[2 * len(pairs) :]
    if not clouds:
        return torch.zeros(len(points), dtype=torch.int64)
    labels = clouds[0][voxel]
    known = labels >= 0
    of_superpoint = superpoints.numpy()
    labels = _majority(of_superpoint[known], labels[known], int(of_superpoint.max()) + 1)[of_superpoint]
    return fill(torch.from_numpy(labels), points)


def _voxels(points: Tensor) -> Array:
    """[N] the voxel of each point, 0 ... V - 1."""
    side = VOXEL * float(nearest_neighbors(points, 4).spacing.median())
    cell = np.floor((points.double().numpy() - points.double().numpy().min(axis=0)) / max(side, 1e-9)).astype(np.int64)
    return np.unique(cell, axis=0, return_inverse=True)[1].reshape(-1)


def _majority(group: Array, labels: Array, count: int) -> Array:
    """[count] the most frequent label of each group (ties: the lower one), -1 = no member."""
    result = np.full(count, -1)
    if len(group) == 0:
        return result
    base = int(labels.max()) + 1
    pair, times = np.unique(group * base + labels, return_counts=True)
    order = np.lexsort((-(pair % base), times, pair // base))  # of several entries of a group, the last one stays
    result[pair[order] // base] = pair[order] % base
    return result


def _merged(first: Array, second: Array, overlap: float) -> Array:
    """[V] the groups of two clouds in one: of a voxel of both, that of the first one."""
    first, second = first.copy(), second.copy()
    for one, other in ((second, first), (first, second)):
        for group, name in _new_names(one, other, overlap).items():
            first[first == group] = name
            second[second == group] = name
    return np.where(first >= 0, first, second)


def _new_names(one: Array, other: Array, overlap: float) -> dict[int, int]:
    """For each group of one cloud the group of the other with which it shares most, if that is enough."""
    size = [dict(zip(*np.unique(cloud[cloud >= 0], return_counts=True), strict=True)) for cloud in (one, other)]
    common = (one >= 0) & (other >= 0)
    pairs, counts = np.unique(np.stack([one[common], other[common]]), axis=1, return_counts=True)
    names: dict[int, int] = {}
    for index in np.lexsort((-pairs[1], counts)):  # of several entries of a group, the last one stays
        group, name = int(pairs[0, index]), int(pairs[1, index])
        names.pop(group, None)
        if group != name and counts[index] >= overlap * min(size[0][group], size[1][name]):
            names[group] = name
    return names
