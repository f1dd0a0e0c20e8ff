"""The merging of a training scene, round by round, from which the model of boundaries learns."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchjoint import ops
from torchjoint.segments.learned.agglomeration import merging_steps
from torchjoint.segments.learned.boundary_features import boundary_features
from torchjoint.segments.learned.boundary_model import BoostedTrees, calibrated
from torchjoint.segments.learned.superpoint_graph import SuperpointGraph
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
        self.of_superpoint: Tensor  # [P] int64, region of each superpoint before the current round
        self.examples: BoundaryExamples  # of these regions

    def start(self, scene: LabelledEvidence) -> None:
        """Begins with the superpoints."""
        self.of_superpoint = torch.arange(len(scene.evidence))
        if self.variant == 0:  # the superpoints of the other variants are the same, and teach nothing new
            self.examples = boundary_examples(scene.evidence, self.of_superpoint, scene.instance)

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
                self.of_superpoint = _merged(scene.evidence, self.of_superpoint, threshold, judge)
        self.examples = boundary_examples(scene.evidence, self.of_superpoint, scene.instance)


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


def _merged(evidence: SuperpointGraph, of_superpoint: Tensor, threshold: float, judge: _Judge) -> Tensor:
    """Merges regions of superpoints [P] up to a threshold: the mean probability over the edges between two regions."""
    graph = evidence.grouped(of_superpoint)
    if graph.pairs.shape[1] == 0:
        return of_superpoint
    cost, count = judge(boundary_features(graph)).float(), graph.boundaries.num_edges
    joined, _ = ops.region_dendrogram(graph.pairs, cost, len(graph), threshold, count)
    return ops.connected_components(joined, len(graph))[of_superpoint]
