"""Evaluates a forest in NumPy: a slow, simple reference for OpenCV's detector."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from torchjoint.images.forest import LABEL_SIZE, Forest
from torchjoint_lab.training.channels import SHRINK, Channels, image_channels, triangle_filter
from torchjoint_lab.training.features import Ints, feature_values, sites


def detect(forest: Forest, image: NDArray[np.float32]) -> NDArray[np.float32]:
    """Computes boundary strength [H, W] of an image [H, W, 3] RGB in [0, 1], equal to OpenCV's ``detectEdges``.

    At each site some of the trees vote for the boundary pixels of their leaf; votes are summed and smoothed.
    """
    channels = image_channels(image)
    rows, columns = sites(channels)
    votes = np.zeros(image.shape[:2], np.int64)
    num_trees = len(forest.children)
    for tree in range(num_trees):
        turn = (tree - (rows + columns) % (2 * forest.trees_per_site)) % num_trees < forest.trees_per_site
        _vote(votes, forest, tree, channels, rows[turn], columns[turn])
    vote = np.float32(2 * SHRINK**2 / LABEL_SIZE**2 / forest.trees_per_site)
    return triangle_filter(votes.astype(np.float32) * vote, 1)


def _vote(votes: Ints, forest: Forest, tree: int, channels: Channels, rows: Ints, columns: Ints) -> None:
    leaves = tree * forest.children.shape[1] + _leaves(forest, tree, channels, rows, columns)
    counts = forest.boundary_counts.ravel()
    ends = np.cumsum(counts, dtype=np.int64)
    for leaf in np.unique(leaves):
        column, row = np.divmod(
            forest.boundary_pixels[ends[leaf] - counts[leaf] : ends[leaf]].astype(np.int64), LABEL_SIZE
        )
        here = leaves == leaf
        np.add.at(votes, (SHRINK * rows[here, None] + row, SHRINK * columns[here, None] + column), 1)


def _leaves(forest: Forest, tree: int, channels: Channels, rows: Ints, columns: Ints) -> Ints:
    """The leaf that each patch reaches."""
    nodes = np.zeros(len(rows), np.int64)
    active = np.arange(len(rows))
    while len(active):
        child = forest.children[tree, nodes[active]]
        active, child = active[child > 0], child[child > 0]
        features = forest.features[tree, nodes[active]].astype(np.int64)
        right = (
            feature_values(channels, rows[active], columns[active], features) >= forest.thresholds[tree, nodes[active]]
        )
        nodes[active] = child - 1 + right
    return nodes
