"""Region growing on superpoints by their masks: SAI3D.

Y. Yin et al., "SAI3D: Segment Any Instance in 3D Scenes" (CVPR 2024). Written from the paper, not from its code.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from scipy import sparse
from torch import Tensor

from torchjoint.cloud.neighbors import nearest_neighbors
from torchjoint.scene.masks import Masks
from torchjoint.views.visibility import Visible
from torchjoint_lab.benchmark.mask_merging.sightings import Array, Sightings, sightings

#: Smallest affinity of a region and its neighbour that merge, stage after stage.
THRESHOLDS = (0.9, 0.8, 0.7, 0.6, 0.5)
#: Weight of the affinity to a member of a region that is two steps away, compared with one that is next to it.
DECAY = 0.5
#: Neighbours of a point, which make superpoints adjacent.
NEIGHBORS = 8
#: Pairs whose histograms are compared at once: bounds the memory.
_PAIRS = 1 << 16


def sai3d(
    points: Tensor,
    visible: Sequence[Visible],
    masks: Sequence[Masks],
    superpoints: Tensor,
    thresholds: Sequence[float] = THRESHOLDS,
    min_points: int = 20,
) -> Tensor:
    """Merges superpoints whose visible points are in the same masks.

    In each view, the affinity of two superpoints is the cosine between their histograms of masks. The affinity over all
    views is the mean, weighted by the product of the two superpoints' visible shares. Regions grow over adjacent
    superpoints, first with a high threshold. With the next, lower one, the regions are the new superpoints. A region's
    affinity to a neighbour is the mean over the region's members near the neighbour. Points without a mask are counted
    as not visible.

    Args:
        points: [N, 3] metres.
        visible: per frame the points that it sees.
        masks: per frame the masks.
        superpoints: [N] int64, 0 ... S - 1.
        thresholds: of the stages, from high to low.
        min_points: smaller regions join the adjacent one with the highest affinity.

    Returns:
        [N] int64 labels.
    """
    seen = sightings(len(points), visible, masks).in_masks()
    neighbors = nearest_neighbors(points, NEIGHBORS).indices.long()
    source = np.repeat(np.arange(len(points)), neighbors.shape[1])
    edges = np.stack([source, neighbors.numpy().ravel()])
    labels = superpoints.numpy().copy()
    for threshold in thresholds:
        labels = _grown(_graph(labels, edges, seen), threshold)[labels]
    labels = _without_small(labels, edges, seen, min_points)
    return torch.from_numpy(np.unique(labels, return_inverse=True)[1].reshape(-1))


class _Graph(NamedTuple):
    """Per region, its neighbours at one or two steps: a row of `affinity` and of `weight`, with the same columns."""

    start: Array  #: [R + 1]
    neighbor: Array  #: [E]
    affinity: Array  #: [E]
    weight: Array  #: [E], 0 if no view sees both
    adjacent: Array  #: [E] bool, one step


def _graph(labels: Array, edges: Array, seen: Sightings) -> _Graph:
    count = int(labels.max()) + 1
    i, j = labels[edges]
    pairs = np.unique(np.concatenate([i * count + j, j * count + i])[np.tile(i != j, 2)])
    one = sparse.csr_array((np.ones(len(pairs), dtype=np.float32), (pairs // count, pairs % count)), (count, count))
    i, j = (one + one @ one).tocoo().coords
    near = np.unique((i * np.int64(count) + j)[i != j])
    i, j = near // count, near % count
    adjacent = np.isin(near, pairs)
    affinity, views = _affinities(labels, count, seen, i, j)
    size = np.bincount(labels, minlength=count)
    weight = np.where(views > 0, np.where(adjacent, 1.0, DECAY) * size[j], 0.0)
    start = np.searchsorted(i, np.arange(count + 1))
    return _Graph(start, j, affinity, weight, adjacent)


def _affinities(labels: Array, count: int, seen: Sightings, i: Array, j: Array) -> tuple[Array, Array]:
    """The mean cosine of the histograms of pairs of regions, and the sum of the weights of the views."""
    shape = count, len(seen.frame_of_mask)
    region, mask = labels[seen.point], seen.mask
    histogram = sparse.csr_array((np.ones(len(region)), (region, mask)), shape).tocoo()
    row, column = histogram.coords
    frame = seen.frame_of_mask[column]
    square = np.zeros((count, seen.num_frames))
    np.add.at(square, (row, frame), histogram.data**2)
    share = np.zeros((count, seen.num_frames))
    np.add.at(share, (region, seen.frame), 1)
    share /= np.maximum(np.bincount(labels, minlength=count), 1)[:, None]
    value = histogram.data / np.sqrt(square[row, frame]) * share[row, frame]
    weighted = sparse.csr_array((value, (row, column)), shape)
    top, bottom = np.zeros(len(i)), np.zeros(len(i))
    for first in range(0, len(i), _PAIRS):
        part = slice(first, first + _PAIRS)
        top[part] = np.asarray(weighted[i[part]].multiply(weighted[j[part]]).sum(axis=1)).reshape(-1)
        bottom[part] = (share[i[part]] * share[j[part]]).sum(axis=1)
    return top / np.maximum(bottom, 1e-12), bottom


def _grown(graph: _Graph, threshold: float) -> Array:
    """[R] the region that each region belongs to after one stage."""
    region = np.full(len(graph.start) - 1, -1)
    free = 0
    for seed in range(len(region)):
        if region[seed] >= 0:
            continue
        region[seed] = free
        queue = deque([seed])
        while queue:
            member = queue.popleft()
            row = slice(graph.start[member], graph.start[member + 1])
            for neighbor in graph.neighbor[row][graph.adjacent[row]]:
                if region[neighbor] < 0 and _affinity_to(graph, neighbor, region == free) >= threshold:
                    region[neighbor] = free
                    queue.append(neighbor)
        free += 1
    return region


def _affinity_to(graph: _Graph, neighbor: int, members: Array) -> float:
    row = slice(graph.start[neighbor], graph.start[neighbor + 1])
    weight = graph.weight[row] * members[graph.neighbor[row]]
    total = weight.sum()
    return float((weight * graph.affinity[row]).sum() / total) if total > 0 else 0.0


def _without_small(labels: Array, edges: Array, seen: Sightings, min_points: int) -> Array:
    """Joins small regions, the smallest first, to the adjacent region with the highest affinity."""
    size = np.bincount(labels)
    graph = _graph(labels, edges, seen)
    owner = np.arange(len(size))
    for region in np.argsort(size, kind="stable"):
        if size[region] >= min_points:
            break
        row = slice(graph.start[region], graph.start[region + 1])
        near, affinity = graph.neighbor[row][graph.adjacent[row]], graph.affinity[row][graph.adjacent[row]]
        other = owner[near] != owner[region]
        if other.any():
            target = owner[near[other][affinity[other].argmax()]]
            size[target] += size[owner[region]]
            owner[owner == owner[region]] = target
    return owner[labels]
