"""The errors that networks make in masks: parts, unions of neighbours, outlines that are off."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from torchjoint_lab.synthetic.furnished.arrays import Array, Rng

#: Pixels between the knots of an outline's displacement, in an image 640 pixels wide.
_JITTER_GRAIN = 16.0
#: How far a cut strays from a straight line, as a share of the mask's extent.
_CUT_NOISE = 0.1
#: Components with a smaller share of a mask are no part of their own.
_LEAST_COMPONENT = 0.1


def smooth_noise(rng: Rng, height: int, width: int, grain: float) -> Array:
    """[height, width] float32, normal noise at knots `grain` pixels apart, interpolated between them."""
    import cv2  # here, because it would slow down the import of the package

    knots = int(np.ceil(height / grain)) + 2, int(np.ceil(width / grain)) + 2
    coarse = rng.standard_normal(knots).astype(np.float32)
    return np.asarray(cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC))


def jittered(rng: Rng, mask: Array, pixels: float) -> Array:
    """[H, W] bool, the mask with its outline displaced smoothly, by `pixels` in the root mean square.

    The displacement is that of an image 640 pixels wide; it scales with the width.
    """
    height, width = mask.shape
    scale = width / 640
    margin = int(np.ceil(4 * pixels * scale)) + 1
    box = _box(mask, margin)
    inside = mask[box]
    down, right = (
        (
            smooth_noise(rng, inside.shape[0], inside.shape[1], max(_JITTER_GRAIN * scale, 2))
            * (pixels * scale / 2**0.5)
        ).round()
        for _ in range(2)
    )
    row, column = np.indices(inside.shape)
    row = np.clip(row + down.astype(np.int64) + box[0].start, 0, height - 1)
    column = np.clip(column + right.astype(np.int64) + box[1].start, 0, width - 1)
    result = np.zeros_like(mask)
    result[box] = mask[row, column]
    return result


def split(rng: Rng, mask: Array, count: int) -> list[Array]:
    """About `count` parts, [H, W] bool each, that cover the mask: its components, clusters of pixels, or stripes.

    Clusters and stripes are cut along curves.
    """
    kind = rng.random()
    if kind < 0.5:
        parts = _components(mask)
        if len(parts) > 1:
            return parts
    row, column = np.nonzero(mask)
    extent = float(max(np.ptp(row), np.ptp(column)) + 1)
    box = _box(mask, 0)
    place = np.stack([row, column], axis=1).astype(np.float64)
    for axis in range(2):
        bend = smooth_noise(rng, mask[box].shape[0], mask[box].shape[1], extent / 3)
        place[:, axis] += _CUT_NOISE * extent * bend[row - box[0].start, column - box[1].start]
    part = _clusters(rng, place, count) if kind < 0.75 else _stripes(rng, place, count)
    parts = []
    for number in np.unique(part):
        result = np.zeros_like(mask)
        result[row[part == number], column[part == number]] = True
        parts.append(result)
    return parts


def merged(rng: Rng, labels: Array, count: int, probability: float) -> Array:
    """[count] the group of each instance: each is merged with one that it touches, with this probability.

    Args:
        rng: draws who merges, and with whom; the longer the common border, the likelier.
        labels: [H, W] instances 0 ... count - 1, -1 = void.
        count: number of instances.
        probability: of each instance that touches another.
    """
    pairs = np.concatenate([np.stack([a.ravel(), b.ravel()]) for a, b in _neighbours(labels)], axis=1)
    pairs = pairs[:, (pairs[0] != pairs[1]) & (pairs.min(axis=0) >= 0)]
    border = np.bincount(pairs[0] * count + pairs[1], minlength=count * count).reshape(count, count)
    border = border + border.T
    group = np.arange(count)
    for instance in range(count):
        length = border[instance].sum()
        if rng.random() < probability and length:
            other = rng.choice(count, p=border[instance] / length)
            group[group == group[instance]] = group[other]
    return group


def _neighbours(labels: Array) -> list[tuple[Array, Array]]:
    return [(labels[:, :-1], labels[:, 1:]), (labels[:-1], labels[1:])]


def _components(mask: Array) -> list[Array]:
    """The connected parts that are not small; the small ones belong to the largest."""
    number, count = ndimage.label(mask)
    area = np.bincount(number.ravel(), minlength=count + 1)[1:]
    large = np.flatnonzero(area >= _LEAST_COMPONENT * area.sum())
    if len(large) < 2:
        return [mask]
    largest = int(area.argmax())
    owner = np.full(count + 1, largest)
    owner[large + 1] = large
    return [mask & (owner[number] == part) for part in large]


def _clusters(rng: Rng, place: Array, count: int) -> Array:
    """[P] the cluster of each place [P, 2], by k-means."""
    center = place[rng.choice(len(place), min(count, len(place)), replace=False)]
    sample = place[rng.choice(len(place), min(2000, len(place)), replace=False)]
    for _ in range(8):
        nearest = _nearest(sample, center)
        for cluster in np.unique(nearest):
            center[cluster] = sample[nearest == cluster].mean(axis=0)
    return _nearest(place, center)


def _nearest(place: Array, center: Array) -> Array:
    return np.asarray(((place[:, None] - center[None]) ** 2).sum(axis=2).argmin(axis=1))


def _stripes(rng: Rng, place: Array, count: int) -> Array:
    """[P] the stripe of each place [P, 2], across a random direction."""
    angle = rng.uniform(0, np.pi)
    along = place @ np.array([np.cos(angle), np.sin(angle)])
    cuts = np.arange(1, count) / count + rng.uniform(-0.5, 0.5, count - 1) / count
    return np.searchsorted(np.quantile(along, cuts), along)


def _box(mask: Array, margin: int) -> tuple[slice, slice]:
    """The rows and columns of the mask, and `margin` pixels around them."""
    spans = []
    for axis in range(2):
        found = np.flatnonzero(mask.any(axis=1 - axis))
        spans.append(slice(max(int(found[0]) - margin, 0), min(int(found[-1]) + margin + 1, mask.shape[axis])))
    return spans[0], spans[1]
