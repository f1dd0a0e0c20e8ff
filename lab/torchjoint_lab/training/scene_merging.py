"""The merging of a training scene, round by round, from which the model of boundaries learns."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchjoint import ops
from torchjoint.segments.learned.agglomeration import crossing_edges, merging_steps
from torchjoint.segments.learned.boundary_features import boundary_features
from torchjoint.segments.learned.boundary_model import BoostedTrees, calibrated
from torchjoint.segments.learned.piece_graph import PieceGraph
from torchjoint_lab.training.boundary_examples import (
    BoundaryExamples,
    BoundaryModelOptions,
    LabelledEvidence,
    boundary_examples,
)


class SceneMerging:
    """One merging of one scene. It may be disturbed by noise, so that it makes other errors than others of the scene.

    Args:
        scene: number of the scene.
        variant: number of the merging; all but number 0 are disturbed.
    """

    def __init__(self, scene: int, variant: int) -> None:
        self.scene, self.variant = scene, variant
        self.region: Tensor  # [N] int64, before the current round
        self.examples: BoundaryExamples  # of these regions

    def start(self, scene: LabelledEvidence) -> None:
        """Begins with the pieces."""
        self.region = scene.evidence.piece
        if self.variant == 0:  # the pieces of the other variants are the same, and teach nothing new
            self.examples = boundary_examples(scene.evidence, self.region, scene.instance)

    def advance(
        self,
        scene: LabelledEvidence,
        number: int,
        trees: BoostedTrees,
        calibration: Tensor,
        options: BoundaryModelOptions,
    ) -> None:
        """Merges as the round before `number` says.

        Args:
            scene: the scene.
            number: of the round that learns from the merged regions, >= 1.
            trees: of the round before, not trained on this scene.
            calibration: of these trees.
            options: of the training.
        """
        seed = [options.seed, number, self.scene, self.variant]
        judge = _Judge(trees, calibration, options.noise if self.variant > 0 else 0.0, np.random.default_rng(seed))
        for index, threshold in merging_steps(options.thresholds):
            if index == number - 1:
                self.region = _merged(scene.evidence, self.region, threshold, judge)
        self.examples = boundary_examples(scene.evidence, self.region, scene.instance)


class _Judge(NamedTuple):
    """The probability of boundaries, with noise in its log odds."""

    trees: BoostedTrees
    calibration: Tensor
    noise: float
    rng: np.random.Generator

    def __call__(self, values: Tensor) -> Tensor:
        """The probability [B] float64 of boundaries with features [B, F]."""
        probability = calibrated(torch.sigmoid(self.trees.score(values)), self.calibration)
        if self.noise == 0:
            return probability
        disturbance = torch.from_numpy(self.rng.normal(0, self.noise, len(probability)))
        return torch.sigmoid(torch.logit(probability, eps=1e-6) + disturbance)


def _merged(evidence: PieceGraph, region: Tensor, threshold: float, judge: _Judge) -> Tensor:
    """Merges regions [N] up to a threshold."""
    pairs, values, of_edge = boundary_features(evidence, region)
    if pairs.shape[1] == 0:
        return region
    return merge_by_probability(region, pairs, of_edge, judge(values), threshold)


def merge_by_probability(
    region: Tensor, pairs: Tensor, of_edge: Tensor, probability: Tensor, threshold: float
) -> Tensor:
    """Repeatedly merges the two regions whose boundary has the lowest mean probability, up to the threshold.

    The mean is over the edges of the point graph that cross the boundary.

    Args:
        region: [N] int64, 0 ... R - 1, region of each point.
        pairs: [2, B] int64, the pairs of regions a < b that edges connect, in ascending order.
        of_edge: [C] int64, the pair that each edge connects, -1 = none.
        probability: [B] that the two regions of a pair belong to different objects.
        threshold: largest mean probability of two regions that merge.

    Returns:
        [N] int64 regions 0, 1, ..., numbered by their first old regions.
    """
    ends, crossing = crossing_edges(pairs, of_edge)
    size = torch.ones(int(region.max()) + 1, dtype=torch.int64)
    return ops.merge_regions(ends, probability.float()[crossing], size, threshold)[region]
