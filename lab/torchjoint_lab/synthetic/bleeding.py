"""The fused cloud of a domain's scene: cells average all points in them, also across the borders of things."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from torchjoint_lab.synthetic.furnished.arrays import Array, Rng
from torchjoint_lab.synthetic.furnished.cloud import Shot

#: Depth pixels that are fused, at most.
_MOST = 700_000
#: Points a cloud should have at least, if the depth images have them.
_LEAST = 3_000


class Observations(NamedTuple):
    """Depth pixels in the world: points [O, 3], colours [O, 3], instances [O], weights [O]."""

    points: Array
    colors: Array
    labels: Array
    weights: Array

    def only(self, keep: Array) -> Observations:
        """Those of a mask [O]."""
        return Observations(self.points[keep], self.colors[keep], self.labels[keep], self.weights[keep])


def observe(rng: Rng, shots: Sequence[Shot], intrinsics: Array, crop: tuple[Array, Array] | None) -> Observations:
    """What all depth images saw (within ``crop``, least and greatest x, y, z), at most some 700,000 pixels of it."""
    seen = [(shot.depth > 0) & (shot.labels >= 0) for shot in shots]
    share = min(1.0, _MOST / max(sum(int(mask.sum()) for mask in seen), 1))
    parts = []
    for shot, mask in zip(shots, seen, strict=True):
        row, column = np.nonzero(mask)
        if share < 1:
            kept = rng.random(len(row)) < share
            row, column = row[kept], column[kept]
        z = shot.depth[row, column].astype(np.float64)
        x = (column - intrinsics[0, 2]) / intrinsics[0, 0] * z
        y = (row - intrinsics[1, 2]) / intrinsics[1, 1] * z
        turn, move = shot.camera_from_world[:3, :3], shot.camera_from_world[:3, 3]
        x, y, depth = x - move[0], y - move[1], z - move[2]
        points = np.stack([x * turn[0, i] + y * turn[1, i] + depth * turn[2, i] for i in range(3)], axis=1)
        colors = shot.image[row, column].astype(np.float64)
        parts.append(Observations(points, colors, shot.labels[row, column], 1 / np.maximum(z, 0.3) ** 2))
    points, colors, labels, weights = (np.concatenate([part[i] for part in parts]) for i in range(4))
    whole = Observations(points, colors, labels, weights)
    if crop is None:
        return whole
    inside: Array = np.all((whole.points > crop[0]) & (whole.points < crop[1]), axis=1)
    return whole.only(inside) if inside.sum() > _LEAST else whole


def thinned(
    rng: Rng, seen: Observations, spacing: float, most: int, exactly: int | None, least_seen: int
) -> tuple[Array, Array, Array]:
    """Points [N, 3], colours [N, 3] and labels [N] of the cells that were seen, one point for each.

    A point is the weighted mean of its cell's observations, its label that of most of them.

    Args:
        rng: draws which points are left out.
        seen: the points to average.
        spacing: side of the cells, metres; made smaller for clouds of fewer than 3,000 points, and larger for those
            of more than ``most``.
        most: points.
        exactly: if given, so many points, as far as there are so many.
        least_seen: cells with fewer observations are left out.

    Raises:
        ValueError: if ``exactly`` asks for more than was seen.
    """
    if exactly is not None and exactly > len(seen.labels):
        raise ValueError(f"num_points: expected at most the {len(seen.labels)} depths of the views, got {exactly}")
    most, least = exactly or most, exactly or min(_LEAST, most)
    cell = spacing
    merged = _merged(seen, cell, least_seen)
    for _ in range(12):
        if len(merged[2]) <= 1.6 * most:
            break
        cell *= float(np.sqrt(len(merged[2]) / most))
        merged = _merged(seen, cell, least_seen)
    for _ in range(12):
        if len(merged[2]) >= least:
            break
        cell, least_seen = cell / 1.6, 1
        merged = _merged(seen, cell, least_seen)
    if exactly is not None and len(merged[2]) < exactly:
        merged = seen.points, seen.colors, seen.labels
    if len(merged[2]) > most:
        kept = np.sort(rng.choice(len(merged[2]), most, replace=False))
        merged = merged[0][kept], merged[1][kept], merged[2][kept]
    order = rng.permutation(len(merged[2]))
    return merged[0][order].astype(np.float32), np.clip(merged[1][order], 0, 1).astype(np.float32), merged[2][order]


def _merged(seen: Observations, cell: float, least_seen: int) -> tuple[Array, Array, Array]:
    index = np.floor(seen.points / cell).astype(np.int64)
    index -= index.min(axis=0)
    span = index.max(axis=0) + 1
    key = (index[:, 0] * span[1] + index[:, 1]) * span[2] + index[:, 2]
    _, group, count = np.unique(key, return_inverse=True, return_counts=True)
    weight = np.bincount(group, seen.weights, len(count))

    def mean(values: Array) -> Array:
        return np.stack(
            [np.bincount(group, values[:, i] * seen.weights, len(count)) / weight for i in range(3)], axis=1
        )

    labels = _majority(group, seen.labels, len(count))
    kept = count >= least_seen
    return mean(seen.points)[kept], mean(seen.colors)[kept], labels[kept]


def _majority(group: Array, labels: Array, count: int) -> Array:
    """[count] the most frequent label of each group; of equal ones the least."""
    base = int(labels.max()) + 1
    pair, times = np.unique(group * base + labels, return_counts=True)
    order = np.lexsort((-(pair % base), times, pair // base))
    result = np.zeros(count, dtype=np.int64)
    result[pair[order] // base] = pair[order] % base
    return result
