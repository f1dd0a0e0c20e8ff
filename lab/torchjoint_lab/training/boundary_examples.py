"""Examples for the model of boundaries: labelled evidence of scenes, and samples of their boundaries."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchjoint.config import Config
from torchjoint.joint import JointSegmenter
from torchjoint.runtime.groups import most_frequent
from torchjoint.runtime.threads import one_thread_per_operation
from torchjoint.scene import Scene
from torchjoint.segments.learned.boundary_features import FEATURE_NAMES, boundary_features
from torchjoint.segments.learned.superpoint_graph import SuperpointGraph
from torchjoint.segments.learned.superpoints import build_superpoint_graph
from torchjoint.views.observations import Observations
from torchjoint_lab.evaluation.partial_truth import knows_points

#: How the names of the features begin that need images, and of those that need colours.
IMAGE_FEATURES = (
    "disagreement_", "contour_", "seen_share", "log_views", "agreement", "overlap_gain", "better_overlap",
    "worse_overlap",
)  # fmt: skip


COLOR_FEATURES = ("color_", "lightness_difference", "chroma_difference", "texture_")


#: Number of frames held in memory at a time.
FRAMES = 4


#: A region counts as an object's if more than this share of its points is labelled.
LEAST_KNOWN = 0.5


@dataclass(frozen=True)
class BoundaryModelOptions:
    """Options of the training.

    Attributes:
        thresholds: one round for each: regions merge up to this mean probability of a border; ascending.
        folds: number of parts of the scenes; each part is judged by trees that were trained on the other parts.
        trees: number of trees in a round.
        leaves: largest number of leaves of a tree.
        learning_rate: factor on the value of each leaf.
        max_boundaries: number of boundaries of a scene and round that are used to grow trees, at random, if there are
            more.
        drop_images_share: share of the boundaries that the trees see a second time without features of images, so that
            they can judge clouds without images.
        drop_colors_share: the same without features of colours.
        variants: how often each scene is merged. All merges of a scene but the first have noise in the probabilities:
            the later rounds have few boundaries to learn from, and meet errors that no training scene has.
        noise: standard deviation of this noise, in log odds.
        members: number of models; the result is their mean. Their random choices, and so their errors, differ.
        seed: of all random choices of the first member; the next seed is that of the second, and so on.
    """

    thresholds: tuple[float, ...] = (0.15, 0.25, 0.35, 0.5)
    folds: int = 4
    trees: int = 60
    leaves: int = 20
    learning_rate: float = 0.2
    max_boundaries: int = 700
    drop_images_share: float = 0.25
    drop_colors_share: float = 0.15
    variants: int = 2
    noise: float = 0.3
    members: int = 1
    seed: int = 0

    def __post_init__(self) -> None:
        for name, least in (
            ("folds", 2),
            ("trees", 1),
            ("leaves", 2),
            ("max_boundaries", 1),
            ("variants", 1),
            ("members", 1),
            ("seed", 0),
        ):
            value = getattr(self, name)
            if not isinstance(value, int) or value < least:
                raise ValueError(f"{name}: expected a whole number >= {least}, got {value!r}")
        for name in ("drop_images_share", "drop_colors_share"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name}: expected a number in [0, 1], got {getattr(self, name)}")
        if not (math.isfinite(self.noise) and self.noise >= 0):
            raise ValueError(f"noise: expected a number >= 0, got {self.noise}")
        if not 0 < self.learning_rate <= 1:
            raise ValueError(f"learning_rate: expected a number in (0, 1], got {self.learning_rate}")
        if not self.thresholds or not all(0 < threshold <= 1 for threshold in self.thresholds):
            raise ValueError(f"thresholds: expected numbers in (0, 1], got {list(self.thresholds)}")
        if list(self.thresholds) != sorted(self.thresholds):
            raise ValueError(f"thresholds: expected ascending numbers, got {list(self.thresholds)}")


class LabelledEvidence(NamedTuple):
    """What the training needs of a scene."""

    evidence: SuperpointGraph
    instance: Tensor  #: [N] int64, true instance of each point of the working cloud, -1 = void


class BoundaryExamples(NamedTuple):
    """The boundaries between the regions of one scene, B of them."""

    pairs: Tensor  # [2, B] int64
    values: Tensor  # [B, F] float32
    is_border: NDArray[np.bool_]  # [B], whether the two regions belong to different objects
    weight: NDArray[np.float64]  # [B], 0 where a region is void


def learned_config(config: Config | None = None) -> Config:
    """The config (default: the package's) with step 6 by the method that this module trains."""
    return (config or Config()).replace({"point_segments": {"method": "learned"}})


@torch.no_grad()
def labelled_evidence(scene: Scene, config: Config | None = None, images: bool = True) -> LabelledEvidence:
    """Runs steps 1-5 on a labelled scene and collects what the features of boundaries are computed from.

    Args:
        scene: with ``truth.points``.
        config: parameters of the steps 1-5.
        images: whether the images have a say; if not, the cameras only orient the normals.

    Raises:
        ValueError: the instance of no point is known.
    """
    if scene.truth is None or scene.truth.points is None or not knows_points(scene.truth):
        raise ValueError(f"scenes: {scene.name or 'a scene'} has no true instances of points to learn from")
    segmenter = JointSegmenter(learned_config(config))
    segmenter.reset(scene.points, scene.colors, scene.normals)
    for start in range(0, len(scene.frames), FRAMES):
        segmenter.update([scene.frames[i] for i in range(start, min(start + FRAMES, len(scene.frames)))])
    graph = segmenter.graph
    assert graph.scales is not None
    state = segmenter.state if images else replace(segmenter.state, observations=Observations())
    with one_thread_per_operation():
        evidence = build_superpoint_graph(graph, graph.scales, state)
    return LabelledEvidence(evidence, _majority(scene.truth.points.long(), segmenter.graph.of_given))


def _majority(instance: Tensor, of_point: Tensor) -> Tensor:
    """The most frequent instance [W] of the given points [N] of each working point; of equally many the lowest."""
    values, number = torch.unique(instance, return_inverse=True)
    return values[most_frequent(number, of_point, torch.ones_like(number))]


def boundary_examples(evidence: SuperpointGraph, of_superpoint: Tensor, instance: Tensor) -> BoundaryExamples:
    """The boundaries of regions of superpoints [P] with their features, and whether they are borders of objects."""
    if int(of_superpoint.max()) == 0:
        return BoundaryExamples(
            torch.empty(2, 0, dtype=torch.int64), torch.empty(0, len(FEATURE_NAMES)), np.empty(0, bool), np.empty(0)
        )
    graph, region = evidence.grouped(of_superpoint), of_superpoint[evidence.superpoint]
    instances, of_point = torch.unique(instance.clamp(min=-1), return_inverse=True)
    counts = torch.bincount(region * len(instances) + of_point, minlength=len(graph) * len(instances))
    counts = counts.view(len(graph), len(instances)).double()
    size = counts.sum(1)
    counts = counts[:, instances >= 0]
    most, majority = counts.max(1)
    known = counts.sum(1)
    purity = most / known.clamp(min=1)
    a, b = graph.pairs
    weight = purity[a] * purity[b]
    has_majority = known > LEAST_KNOWN * size
    weight = weight * (has_majority[a] & has_majority[b])
    # Small things count as much as large ones, as in the scores of segmentations.
    # Large scenes count more than small ones, but less than in proportion to their boundaries.
    weight *= math.sqrt(int((weight > 0).sum())) / max(float(weight.sum()), 1e-9)
    return BoundaryExamples(graph.pairs, boundary_features(graph), (majority[a] != majority[b]).numpy(), weight.numpy())


class Sample(NamedTuple):
    """Rows from which trees are grown."""

    values: NDArray[np.float32]
    is_border: NDArray[np.bool_]
    weight: NDArray[np.float64]


def draw_sample(boundaries: BoundaryExamples, rng: np.random.Generator, options: BoundaryModelOptions) -> Sample:
    """Some of the boundaries, and copies of some of these without images or colours."""
    rows = np.flatnonzero(boundaries.weight > 0)
    total = len(rows)
    if total > options.max_boundaries:
        rows = np.sort(rng.choice(rows, options.max_boundaries, replace=False))
    values, is_border = boundaries.values.numpy()[rows], boundaries.is_border[rows]
    weight = boundaries.weight[rows] * (total / max(len(rows), 1))
    parts = [Sample(values, is_border, weight)]
    for share, prefixes in (
        (options.drop_images_share, IMAGE_FEATURES), (options.drop_colors_share, COLOR_FEATURES),
    ):  # fmt: skip
        copied = rng.random(len(rows)) < share
        without = values[copied]
        without[:, feature_columns(prefixes)] = np.nan
        parts.append(Sample(without, is_border[copied], weight[copied]))
    return join_samples(parts)


def feature_columns(prefixes: tuple[str, ...]) -> list[int]:
    """The columns of the features whose names begin with one of the prefixes.

    Raises:
        ValueError: no feature's name begins with one of them.
    """
    for prefix in prefixes:
        if not any(name.startswith(prefix) for name in FEATURE_NAMES):
            raise ValueError(f"features: no name begins with {prefix!r}")
    return [column for column, name in enumerate(FEATURE_NAMES) if name.startswith(prefixes)]


def join_samples(samples: Sequence[Sample]) -> Sample:
    """One sample of all."""
    values, is_border, weight = (np.concatenate(parts) for parts in zip(*samples, strict=True))
    return Sample(values, is_border, weight)
