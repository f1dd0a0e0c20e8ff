"""Grows one structured tree: nodes split patches with different segmentations.

At each node, random pairs of label pixels are compared (same segment or not). The sign of the first principal component
of these bits divides the patches into two classes. The node gets the feature and threshold that best separate the
classes (Gini). P. Dollár and C. L. Zitnick, "Fast Edge Detection Using Structured Forests" (PAMI 2015), sections 3, 4.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from torchjoint.images.forest import LABEL_SIZE
from torchjoint_lab.training.patches import NUM_CODES, Samples

Bits = NDArray[np.float32]
Ints = NDArray[np.integer]

_FIRST, _SECOND = np.triu_indices(LABEL_SIZE**2, 1)
_POWER_ITERATIONS = 8


@dataclass(frozen=True)
class TreeOptions:
    """Options of a tree.

    Attributes:
        min_child: smallest number of samples of a node.
        max_depth: largest depth of the tree.
        features_tried: number of features tried at a node.
        pairs: number of pairs of label pixels compared at a node.
        node_samples: a node with more samples chooses its split on a random subset of this size.
    """

    min_child: int = 8
    max_depth: int = 64
    features_tried: int = 60
    pairs: int = 256
    node_samples: int = 10_000

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not isinstance(value, int) or value < 1:
                raise ValueError(f"{name}: expected a whole number >= 1, got {value!r}")


class Tree(NamedTuple):
    """A tree of N nodes; L of them are leaves."""

    children: NDArray[np.int32]  #: [N] 0 at a leaf, else 1 + index of the left child; the right child follows
    features: NDArray[np.int32]  #: [N] row of the samples' codes
    codes: NDArray[np.int32]  #: [N] samples with at most this code go left
    segments: NDArray[np.uint16]  #: [L, 256] segments of each leaf's most typical sample, in the order of nodes


def grow_tree(
    samples: Samples,
    rng: np.random.Generator,
    options: TreeOptions,
    settled: Callable[[int], object] = lambda count: None,
) -> Tree:
    """Grows a tree; `settled` is called with the number of samples in each finished leaf."""
    nodes = [(0, 0, 0)]
    leaves: dict[int, NDArray[np.uint16]] = {}
    waiting = [(0, 0, np.arange(samples.codes.shape[1], dtype=np.int32))]
    while waiting:
        place, depth, members = waiting.pop()
        some = members if len(members) <= options.node_samples else rng.choice(members, options.node_samples)
        bits = _pair_bits(samples.segments, some, rng, options.pairs)
        split = _split(samples, members, some, bits, rng, options) if depth < options.max_depth else None
        if split is None:
            leaves[place] = samples.segments[some[_most_typical(bits)]]
            settled(len(members))
            continue
        feature, code, left = split
        child = len(nodes)
        nodes[place] = (child + 1, feature, code)
        nodes += [(0, 0, 0), (0, 0, 0)]
        waiting += [(child, depth + 1, members[left]), (child + 1, depth + 1, members[~left])]
    segments = np.stack([leaves[place] for place in sorted(leaves)])
    children, features, codes = np.array(nodes, np.int32).T.copy()
    return Tree(children, features, codes, segments)


def _split(
    samples: Samples, members: Ints, some: Ints, bits: Bits, rng: np.random.Generator, options: TreeOptions
) -> tuple[int, int, NDArray[np.bool_]] | None:
    """(feature, code, mask of the members that go left), or None if no split separates them."""
    if len(members) < 2 * options.min_child:
        return None
    classes = _two_classes(bits, rng)
    if classes is None:
        return None
    num_features = len(samples.codes)
    features = rng.choice(num_features, min(options.features_tried, num_features), replace=False)
    codes = np.stack([samples.codes[feature].take(some) for feature in features])
    found = _best_split(codes, classes, options.min_child * len(some) / len(members))
    if found is None:
        return None
    feature, code = int(features[found[0]]), found[1]
    left = samples.codes[feature].take(members) <= code
    count = np.count_nonzero(left)
    return None if min(count, len(members) - count) < options.min_child else (feature, code, left)


def _pair_bits(segments: NDArray[np.uint16], members: Ints, rng: np.random.Generator, count: int) -> Bits:
    """[S, count]: 1 if a pair of label pixels lies in one segment; all samples use the same pairs."""
    pairs = rng.integers(0, len(_FIRST), count)
    pixels = segments[members].T.copy()  # gathering rows is faster than gathering columns
    return (pixels[_FIRST[pairs]] == pixels[_SECOND[pairs]]).T.astype(np.float32)


def _two_classes(bits: Bits, rng: np.random.Generator) -> NDArray[np.bool_] | None:
    """[S]: side of the mean along the first principal component; None if all samples are equal."""
    centered = bits - bits.mean(axis=0)
    direction = rng.standard_normal(bits.shape[1], np.float32)
    for _ in range(_POWER_ITERATIONS):
        direction = centered.T @ (centered @ direction)
        length = np.sqrt(direction @ direction)
        if length < 1e-6:
            return None
        direction /= length
    return centered @ direction > 0


def _best_split(codes: NDArray[np.uint8], classes: NDArray[np.bool_], min_child: float) -> tuple[int, int] | None:
    """(row, code) of the split of [F, S] codes with the smallest Gini impurity; of equals the first.

    None if no split leaves `min_child` samples on both sides and lowers the impurity.
    """
    rows = len(codes)
    keys = codes + (NUM_CODES * classes).astype(np.int32) + (2 * NUM_CODES * np.arange(rows, dtype=np.int32))[:, None]
    counts = np.bincount(keys.ravel(), minlength=rows * 2 * NUM_CODES)
    left = counts.reshape(rows, 2, NUM_CODES).cumsum(axis=2).astype(np.float64)
    total = left[:1, :, -1:]
    right = total - left
    num_left, num_right = left.sum(axis=1), right.sum(axis=1)
    # Twice the size-weighted Gini impurity is the size minus purity: each side's sum of squared counts over its size.
    purity = (left**2).sum(axis=1) / num_left.clip(min=1) + (right**2).sum(axis=1) / num_right.clip(min=1)
    purity[(num_left < min_child) | (num_right < min_child)] = 0
    row, code = divmod(int(purity.argmax()), NUM_CODES)
    before = float((total**2).sum() / total.sum())
    return (row, code) if purity[row, code] > before + 1e-9 else None


def _most_typical(bits: Bits) -> int:
    """Index of the sample nearest to the mean."""
    return int(((bits - bits.mean(axis=0)) ** 2).sum(axis=1).argmin())
