"""Trains the model of step 6, method learned: is there a border between two neighbouring regions?

Each round of merging has its own boosted trees. Trees judge the regions that the round before made of scenes that it
was not trained on, so that the next round learns from such errors as it will meet.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from tqdm import tqdm

from torchjoint.config import Config
from torchjoint.joint import JointSegmenter
from torchjoint.points.agglomeration import merge_by_probability
from torchjoint.points.boundary_features import FEATURE_NAMES, boundary_features
from torchjoint.points.boundary_model import BoostedTrees, BoundaryModel, calibrated, no_calibration
from torchjoint.points.evidence import Evidence, gather_evidence
from torchjoint.runtime.threads import one_thread_per_operation, parallel_map
from torchjoint.scene import Scene

#: How the names of the features begin that need images, and of those that need colours.
IMAGE_FEATURES = (
    "disagreement_", "contour_", "seen_share", "log_views", "agreement", "overlap_gain", "better_overlap",
    "worse_overlap",
)  # fmt: skip
COLOR_FEATURES = ("color_", "lightness_difference", "chroma_difference")
#: Number of frames held in memory at a time.
FRAMES = 4
#: Largest number of knots of a calibration.
KNOTS = 64
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
        seed: of all random choices.
    """

    thresholds: tuple[float, ...] = (0.15, 0.25, 0.35, 0.5)
    folds: int = 4
    trees: int = 120
    leaves: int = 20
    learning_rate: float = 0.1
    max_boundaries: int = 1500
    drop_images_share: float = 0.25
    drop_colors_share: float = 0.15
    seed: int = 0

    def __post_init__(self) -> None:
        for name, least in (("folds", 2), ("trees", 1), ("leaves", 2), ("max_boundaries", 1), ("seed", 0)):
            value = getattr(self, name)
            if not isinstance(value, int) or value < least:
                raise ValueError(f"{name}: expected a whole number >= {least}, got {value!r}")
        for name in ("drop_images_share", "drop_colors_share"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name}: expected a number in [0, 1], got {getattr(self, name)}")
        if not 0 < self.learning_rate <= 1:
            raise ValueError(f"learning_rate: expected a number in (0, 1], got {self.learning_rate}")
        if not self.thresholds or not all(0 < threshold <= 1 for threshold in self.thresholds):
            raise ValueError(f"thresholds: expected numbers in (0, 1], got {list(self.thresholds)}")
        if list(self.thresholds) != sorted(self.thresholds):
            raise ValueError(f"thresholds: expected ascending numbers, got {list(self.thresholds)}")


class LabelledEvidence(NamedTuple):
    """What the training needs of a scene."""

    evidence: Evidence
    instance: Tensor  #: [N] int64, true instance of each point, -1 = void


class Bin(NamedTuple):
    """Boundaries whose probabilities are in one fifth of [0, 1]; means are weighted."""

    boundaries: int
    probability: float  #: mean of the trees' probabilities, before the calibration
    share: float  #: share of the boundaries that are borders of objects


class RoundScores(NamedTuple):
    """How well the trees of one round judged scenes that they were not trained on."""

    threshold: float
    boundaries: int
    auc: float  #: area under the curve of hits and false alarms; NaN if all boundaries are of one kind
    bins: tuple[Bin, ...]  #: five


class _Boundaries(NamedTuple):
    """The boundaries between the regions of one scene, B of them."""

    pairs: Tensor  # [2, B] int64
    values: Tensor  # [B, F] float32
    is_border: NDArray[np.bool_]  # [B], whether the two regions belong to different objects
    weight: NDArray[np.float64]  # [B], 0 where a region is void


def learned_config(config: Config | None = None) -> Config:
    """The config (default: the package's) with step 6 by the method that this module trains."""
    return (config or Config()).set(["point_segments.method=learned"])


@torch.no_grad()
def labelled_evidence(scene: Scene, config: Config | None = None) -> LabelledEvidence:
    """Runs steps 1-5 on a labelled scene and collects what the features of boundaries are computed from.

    Args:
        scene: with ``truth.points``.
        config: parameters of the steps 1-5.

    Raises:
        ValueError: the instance of no point is known.
    """
    if scene.truth is None or scene.truth.points is None or not scene.truth.has_points:
        raise ValueError(f"scenes: {scene.name or 'a scene'} has no true instances of points to learn from")
    segmenter = JointSegmenter(learned_config(config))
    segmenter.reset(scene.points, scene.colors, scene.normals)
    for start in range(0, len(scene.frames), FRAMES):
        segmenter.update([scene.frames[i] for i in range(start, min(start + FRAMES, len(scene.frames)))])
    graph = segmenter._require_graph()
    assert graph.scales is not None
    with one_thread_per_operation():
        evidence = gather_evidence(graph, graph.scales, segmenter.state, segmenter.config)
    return LabelledEvidence(evidence, scene.truth.points.long())


def train_boundary_model(
    scenes: Iterable[Scene],
    options: BoundaryModelOptions = BoundaryModelOptions(),
    *,
    config: Config | None = None,
    report: Callable[[RoundScores], None] | None = None,
    progress: bool = False,
) -> BoundaryModel:
    """Trains a model on labelled scenes.

    Args:
        scenes: at least two, with ``truth.points``; each is needed only once, and not kept.
        options: equal scenes and options make equal models, whatever the number of threads.
        config: parameters of the steps 1-5.
        report: called after each round.
        progress: show progress bars.

    Raises:
        ValueError: fewer than two scenes, or one without true instances.
    """
    prepared = [
        labelled_evidence(scene, config) for scene in tqdm(scenes, desc="evidence", unit="scene", disable=not progress)
    ]
    return fit_boundary_model(prepared, options, report=report, progress=progress)


@torch.no_grad()
def fit_boundary_model(
    scenes: Sequence[LabelledEvidence],
    options: BoundaryModelOptions = BoundaryModelOptions(),
    *,
    report: Callable[[RoundScores], None] | None = None,
    progress: bool = False,
) -> BoundaryModel:
    """As :func:`train_boundary_model`, from what :func:`labelled_evidence` returns.

    Args:
        scenes: at least two; the sequence may be lazy, since one scene is used at a time, once in each round.
        options: of the training.
        report: called after each round.
        progress: show progress bars.
    """
    if len(scenes) < 2:
        raise ValueError(f"scenes: expected at least two, got {len(scenes)}")
    rng = np.random.default_rng(options.seed)
    fold = rng.permutation(len(scenes)) % options.folds
    regions: list[Tensor] = []
    rounds: list[BoostedTrees] = []
    calibrations: list[Tensor] = []
    boundaries: list[_Boundaries] = []
    judged: list[Tensor] = []  # of each scene: the probability [B] of its boundaries
    for number, threshold in enumerate(options.thresholds):
        before, boundaries = boundaries, []
        name = f"round {number + 1} of {len(options.thresholds)}"
        for i in tqdm(range(len(scenes)), desc=f"{name}: features", unit="scene", disable=not progress):
            evidence, instance = scenes[i]
            with one_thread_per_operation():
                if number == 0:
                    regions.append(evidence.piece)
                elif before[i].pairs.shape[1]:
                    merge_up_to = options.thresholds[number - 1]
                    regions[i] = merge_by_probability(evidence, regions[i], before[i].pairs, judged[i], merge_up_to)
                boundaries.append(_boundaries(evidence, regions[i], instance))
        samples = [_sample(one, rng, options) for one in boundaries]
        parts = sorted(set(fold.tolist()))
        *of_parts, final = _fit_all(samples, fold, parts, options, f"{name}: trees" if progress else None)
        rounds.append(final)
        scores = [
            torch.sigmoid(of_parts[parts.index(part)].score(one.values))
            for one, part in zip(boundaries, fold.tolist(), strict=True)
        ]
        is_border = np.concatenate([one.is_border for one in boundaries])
        weight = np.concatenate([one.weight for one in boundaries])
        probability = torch.cat(scores).numpy()
        known = weight > 0
        calibrations.append(_calibration(probability[known], is_border[known], weight[known]))
        if report is not None:
            report(_scores(threshold, probability[known], is_border[known], weight[known]))
        judged = [calibrated(score, calibrations[-1]) for score in scores]
    return BoundaryModel(options.thresholds, FEATURE_NAMES, tuple(rounds), tuple(calibrations))


def trees_of_classifier(classifier: Any) -> BoostedTrees:
    """The trees of a fitted ``HistGradientBoostingClassifier`` of two classes, without categorical features."""
    trees = [of_class[0].nodes for of_class in classifier._predictors]
    length = max(len(nodes) for nodes in trees)

    def padded(name: str, dtype: Any, padding: Any) -> Tensor:
        rows = [np.pad(nodes[name].astype(dtype), (0, length - len(nodes)), constant_values=padding) for nodes in trees]
        return torch.from_numpy(np.stack(rows))

    is_leaf = padded("is_leaf", bool, True)
    # Where all that is known goes left, and what is missing right, scikit-learn's threshold is infinite.
    threshold = padded("num_threshold", np.float64, 0).nan_to_num(posinf=torch.finfo(torch.float64).max)
    return BoostedTrees(
        feature=padded("feature_idx", np.int32, 0).masked_fill(is_leaf, 0),
        threshold=threshold.masked_fill(is_leaf, 0),
        missing_left=padded("missing_go_to_left", bool, False) & ~is_leaf,
        left=padded("left", np.int32, -1).masked_fill(is_leaf, -1),
        right=padded("right", np.int32, -1).masked_fill(is_leaf, -1),
        leaf_value=padded("value", np.float64, 0).masked_fill(~is_leaf, 0),
        baseline=float(classifier._baseline_prediction.item()),
    )


def _boundaries(evidence: Evidence, region: Tensor, instance: Tensor) -> _Boundaries:
    """The boundaries of a scene with their features, and whether they are borders of objects."""
    if int(region.max()) == 0:
        return _Boundaries(
            torch.empty(2, 0, dtype=torch.int64), torch.empty(0, len(FEATURE_NAMES)), np.empty(0, bool), np.empty(0)
        )
    pairs, values = boundary_features(evidence, region)
    instances, of_point = torch.unique(instance.clamp(min=-1), return_inverse=True)
    num_regions = int(region.max()) + 1
    counts = torch.bincount(region * len(instances) + of_point, minlength=num_regions * len(instances))
    counts = counts.view(num_regions, len(instances)).double()
    size = counts.sum(1)
    counts = counts[:, instances >= 0]
    most, majority = counts.max(1)
    known = counts.sum(1)
    purity = most / known.clamp(min=1)
    a, b = pairs
    weight = purity[a] * purity[b] * torch.minimum(size[a], size[b]).sqrt()
    has_majority = known > LEAST_KNOWN * size
    weight = weight * (has_majority[a] & has_majority[b])
    # Large scenes count more than small ones, but less than in proportion to their boundaries.
    weight *= math.sqrt(int((weight > 0).sum())) / max(float(weight.sum()), 1e-9)
    return _Boundaries(pairs, values, (majority[a] != majority[b]).numpy(), weight.numpy())


class _Sample(NamedTuple):
    """Rows from which trees are grown."""

    values: NDArray[np.float32]
    is_border: NDArray[np.bool_]
    weight: NDArray[np.float64]


def _sample(boundaries: _Boundaries, rng: np.random.Generator, options: BoundaryModelOptions) -> _Sample:
    """Some of the boundaries, and copies of some of these without images or colours."""
    rows = np.flatnonzero(boundaries.weight > 0)
    total = len(rows)
    if total > options.max_boundaries:
        rows = np.sort(rng.choice(rows, options.max_boundaries, replace=False))
    values, is_border = boundaries.values.numpy()[rows], boundaries.is_border[rows]
    weight = boundaries.weight[rows] * (total / max(len(rows), 1))
    parts = [_Sample(values, is_border, weight)]
    for share, prefixes in (
        (options.drop_images_share, IMAGE_FEATURES), (options.drop_colors_share, COLOR_FEATURES),
    ):  # fmt: skip
        copied = rng.random(len(rows)) < share
        without = values[copied]
        without[:, feature_columns(prefixes)] = np.nan
        parts.append(_Sample(without, is_border[copied], weight[copied]))
    return _joined(parts)


def feature_columns(prefixes: tuple[str, ...]) -> list[int]:
    """The columns of the features whose names begin with one of the prefixes.

    Raises:
        ValueError: no feature's name begins with one of them.
    """
    for prefix in prefixes:
        if not any(name.startswith(prefix) for name in FEATURE_NAMES):
            raise ValueError(f"features: no name begins with {prefix!r}")
    return [column for column, name in enumerate(FEATURE_NAMES) if name.startswith(prefixes)]


def _joined(samples: Sequence[_Sample]) -> _Sample:
    values, is_border, weight = (np.concatenate(parts) for parts in zip(*samples, strict=True))
    return _Sample(values, is_border, weight)


def _fit_all(
    samples: Sequence[_Sample],
    fold: NDArray[np.int64],
    parts: Sequence[int],
    options: BoundaryModelOptions,
    progress: str | None,
) -> list[BoostedTrees]:
    """For each part the trees that were fitted to all scenes outside this part; at the end those of all scenes."""
    import sklearn.ensemble  # noqa: F401  before the limit, which counts only for libraries that are loaded
    from threadpoolctl import threadpool_limits

    with tqdm(total=len(parts) + 1, desc=progress, unit="fit", disable=progress is None) as bar:

        def fit(part: int | None) -> BoostedTrees:
            # One thread for each fit: several threads inside a fit wait for each other most of the time.
            with threadpool_limits(1, user_api="openmp"):
                trees = _grow(
                    [sample for sample, of in zip(samples, fold.tolist(), strict=True) if of != part], options
                )
            bar.update()
            return trees

        return parallel_map(fit, [*parts, None])


def _grow(samples: Sequence[_Sample], options: BoundaryModelOptions) -> BoostedTrees:
    """Boosted trees fitted to the rows of all samples; no tree at all if all rows have the same answer."""
    from sklearn.ensemble import HistGradientBoostingClassifier

    values, is_border, weight = _joined(samples)
    borders = int(is_border.sum())
    if borders in (0, len(is_border)):
        return _constant(math.log((borders + 1) / (len(is_border) - borders + 1)))
    classifier = HistGradientBoostingClassifier(
        max_iter=options.trees,
        max_leaf_nodes=options.leaves,
        learning_rate=options.learning_rate,
        l2_regularization=1.0,
        min_samples_leaf=20,
        early_stopping=False,
        random_state=options.seed,
    )
    classifier.fit(values, is_border, sample_weight=weight)
    return trees_of_classifier(classifier)


def _constant(log_odds: float) -> BoostedTrees:
    none = torch.empty(0, 1)
    places = none.int()
    return BoostedTrees(places, none.double(), none.bool(), places, places, none.double(), log_odds)


def _calibration(probability: NDArray[np.float64], is_border: NDArray[np.bool_], weight: NDArray[np.float64]) -> Tensor:
    """The ascending map [2, C] of probabilities that fits the answers best, at most KNOTS knots."""
    from sklearn.isotonic import IsotonicRegression

    if len(probability) == 0:
        return no_calibration()
    fitted = IsotonicRegression(y_min=0, y_max=1).fit(probability, is_border, sample_weight=weight)
    knots = np.stack([fitted.X_thresholds_, fitted.y_thresholds_]).astype(np.float64)
    if knots.shape[1] < 2:
        return torch.tensor([[0.0, 1.0], [float(knots[1, 0])] * 2], dtype=torch.float64)
    kept = np.unique(np.linspace(0, knots.shape[1] - 1, KNOTS).round().astype(np.int64))
    return torch.from_numpy(knots[:, kept].clip(0, 1))


def _scores(
    threshold: float,
    probability: NDArray[np.float64],
    is_border: NDArray[np.bool_],
    weight: NDArray[np.float64],
) -> RoundScores:
    from sklearn.metrics import roc_auc_score

    both = 0 < is_border.sum() < len(is_border)
    auc = float(roc_auc_score(is_border, probability, sample_weight=weight)) if both else math.nan
    fifth = np.minimum((probability * 5).astype(np.int64), 4)
    count, total, predicted, borders = (
        np.bincount(fifth, weights, minlength=5)
        for weights in (np.ones(len(weight)), weight, weight * probability, weight * is_border)
    )
    safe = np.where(total > 0, total, np.nan)
    columns = zip(count.tolist(), (predicted / safe).tolist(), (borders / safe).tolist(), strict=True)
    return RoundScores(threshold, len(probability), auc, tuple(Bin(int(n), mean, share) for n, mean, share in columns))
