"""Fuses the depth images to a point cloud: averages repeated observations, then samples unevenly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from torchjoint_lab.synthetic.furnished.arrays import Array, Rng

#: Side of the cells in which observations are averaged, metres.
_CELL = 0.006
#: Largest number of depth pixels per output point.
_PIXELS_PER_POINT = 8


@dataclass(frozen=True)
class Shot:
    """One image, as input of the fusion."""

    image: Array  #: [H, W, 3] in [0, 1]
    depth: Array  #: [H, W] metres, 0 = none
    labels: Array  #: [H, W] the instance whose surface each depth was measured on
    camera_from_world: Array  #: [4, 4] reported, not true, pose


def fuse(rng: Rng, shots: Sequence[Shot], intrinsics: Array, num_points: int) -> tuple[Array, Array, Array]:
    """Fuses a cloud like a real fusion: dense where the camera was near, empty where it never looked.

    Observations of one instance in one cell are averaged (position and colour), as in a volume. Cells are sampled; the
    probability of a cell grows with the number of its observations.

    Args:
        rng: source of all random choices.
        shots: the images.
        intrinsics: [3, 3], pixels.
        num_points: size of the cloud.

    Returns:
        points [num_points, 3] metres, world frame; colours [num_points, 3]; labels [num_points].

    Raises:
        ValueError: the images have fewer valid depths than ``num_points``.
    """
    # Real clouds are dense where the camera stayed long: some views count more, some not at all.
    share = rng.uniform(0.0, 2.0, len(shots))
    if len(shots) > 4:
        share[share < 0.3] = 0.0
    budget = np.ceil(_PIXELS_PER_POINT * num_points * share / max(share.sum(), 1e-9)).astype(int)
    observed = [_observe(rng, shot, intrinsics, int(n)) for shot, n in zip(shots, budget, strict=True)]
    if sum(len(o[2]) for o in observed) < 2 * num_points:
        observed = [_observe(rng, shot, intrinsics, shot.depth.size) for shot in shots]
    points, colors, labels = (np.concatenate([o[i] for o in observed]) for i in range(3))
    if len(points) < num_points:
        raise ValueError(
            f"num_points: expected at most the {len(points)} depths that the {len(shots)} views have, got {num_points}"
        )
    cell = _CELL
    merged = _average(points, colors, labels, cell)
    while len(merged[2]) < num_points and cell > 1e-4:
        cell /= 2
        merged = _average(points, colors, labels, cell)
    if len(merged[2]) < num_points:
        merged = points, colors, labels, np.ones(len(points))
    weight = merged[3] ** 0.65
    chosen = rng.choice(len(weight), num_points, replace=False, p=weight / weight.sum())
    return merged[0][chosen].astype(np.float32), merged[1][chosen].astype(np.float32), merged[2][chosen]


def _observe(rng: Rng, shot: Shot, intrinsics: Array, count: int) -> tuple[Array, Array, Array]:
    """Samples up to ``count`` random depths of one image: world points, colours, labels."""
    row, column = np.nonzero((shot.depth > 0) & (shot.labels >= 0))
    if count < len(row):
        trust = 1 / shot.depth[row, column].astype(np.float64)  # fusion gives distant, noisy depths a smaller weight
        keep = rng.choice(len(row), count, replace=False, p=trust / trust.sum())
        row, column = row[keep], column[keep]
    z = shot.depth[row, column].astype(np.float64)
    x = (column - intrinsics[0, 2]) / intrinsics[0, 0] * z
    y = (row - intrinsics[1, 2]) / intrinsics[1, 1] * z
    rotation, translation = shot.camera_from_world[:3, :3], shot.camera_from_world[:3, 3]
    x, y, z = x - translation[0], y - translation[1], z - translation[2]
    # Written out, since a BLAS product may round differently with another number of threads.
    points = np.stack([x * rotation[0, i] + y * rotation[1, i] + z * rotation[2, i] for i in range(3)], axis=1)
    return points, shot.image[row, column].astype(np.float64), shot.labels[row, column]


def _average(points: Array, colors: Array, labels: Array, cell: float) -> tuple[Array, Array, Array, Array]:
    """Means over each (cell, label): points, colours, labels, and the number of averaged observations."""
    index = np.floor(points / cell).astype(np.int64)
    index -= index.min(axis=0)
    span = index.max(axis=0) + 1
    key = ((index[:, 0] * span[1] + index[:, 1]) * span[2] + index[:, 2]) * (labels.max() + 1) + labels
    _, first, group, count = np.unique(key, return_index=True, return_inverse=True, return_counts=True)

    def mean(values: Array) -> Array:
        return np.stack([np.bincount(group, values[:, i], len(count)) for i in range(3)], axis=1) / count[:, None]

    return mean(points), mean(colors), labels[first], count
