"""Trains the model of step 6, method learned: is there a border between two neighbouring regions?

Each round of merging has its own boosted trees. Trees judge the regions that the round before made of scenes that it
was not trained on, so that the next round learns from such errors as it will meet. If it was not trained on any scene
of this kind, its probabilities also mean on other kinds what they say.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from tqdm import tqdm

from torchjoint.config import Config
from torchjoint.runtime.messages import needed_for
from torchjoint.runtime.threads import parallel_map
from torchjoint.scene import Scene
from torchjoint.segments.learned.boundary_features import FEATURE_NAMES
from torchjoint.segments.learned.boundary_model import BoostedTrees, BoundaryModel, MemberModel
from torchjoint_lab.training.boundary_examples import (
    BoundaryModelOptions,
    LabelledEvidence,
    Sample,
    draw_sample,
    join_samples,
    labelled_evidence,
)
from torchjoint_lab.training.quantile_bins import QuantileBins
from torchjoint_lab.training.scene_merging import SceneMerging

#: Largest number of knots of a calibration.
KNOTS = 64


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


def train_boundary_model(
    scenes: Iterable[Scene],
    options: BoundaryModelOptions | None = None,
    *,
    config: Config | None = None,
    kinds: Sequence[str] | None = None,
    report: Callable[[RoundScores], None] | None = None,
    progress: bool = False,
) -> BoundaryModel:
    """Trains a model on labelled scenes.

    Args:
        scenes: at least two, with ``truth.points``; each is needed only once, and not kept.
        options: equal scenes and options make equal models with any number of threads.
        config: parameters of the steps 1-5.
        kinds: the kind of each scene. If there are several, each is a part that is judged by trees which did not see
            it; else the parts are random (`options.folds`).
        report: called after each round of each member.
        progress: show progress bars.

    Raises:
        ModuleNotFoundError: scikit-learn is not installed.
        ValueError: fewer than two scenes, or one without true instances.
    """
    _check_packages()
    options = options or BoundaryModelOptions()
    prepared = [
        labelled_evidence(scene, config) for scene in tqdm(scenes, desc="evidence", unit="scene", disable=not progress)
    ]
    return fit_boundary_model(prepared, options, kinds=kinds, report=report, progress=progress)


@torch.no_grad()
def fit_boundary_model(
    scenes: Sequence[LabelledEvidence],
    options: BoundaryModelOptions | None = None,
    *,
    kinds: Sequence[str] | None = None,
    report: Callable[[RoundScores], None] | None = None,
    progress: bool = False,
) -> BoundaryModel:
    """As :func:`train_boundary_model`, from what :func:`labelled_evidence` returns.

    Args:
        scenes: at least two; the sequence may be lazy, since few scenes are used at a time, each once in each round of
            each member.
        options: of the training.
        kinds: as there.
        report: called after each round of each member.
        progress: show progress bars.
    """
    _check_packages()
    options = options or BoundaryModelOptions()
    if len(scenes) < 2:
        raise ValueError(f"scenes: expected at least two, got {len(scenes)}")
    if kinds is not None and len(kinds) != len(scenes):
        raise ValueError(f"kinds: expected one for each of {len(scenes)} scenes, got {len(kinds)}")
    seeds = range(options.seed, options.seed + options.members)
    members = [_fit_member(scenes, replace(options, seed=seed), kinds, report, progress) for seed in seeds]
    return BoundaryModel(tuple(members))


def _fit_member(
    scenes: Sequence[LabelledEvidence],
    options: BoundaryModelOptions,
    kinds: Sequence[str] | None,
    report: Callable[[RoundScores], None] | None,
    progress: bool,
) -> MemberModel:
    rng = np.random.default_rng(options.seed)
    fold = _parts(rng, len(scenes), options.folds, kinds)
    parts = sorted(set(fold.tolist()))
    runs = [SceneMerging(scene, variant) for scene in range(len(scenes)) for variant in range(options.variants)]
    of_run = fold[[run.scene for run in runs]]
    rounds: list[BoostedTrees] = []
    calibrations: list[Tensor] = []
    of_parts: list[BoostedTrees] = []
    for number, threshold in enumerate(options.thresholds):
        name = f"seed {options.seed}, round {number + 1} of {len(options.thresholds)}"
        judges = [(of_parts[parts.index(part)], calibrations[-1]) for part in fold.tolist()] if of_parts else None
        _merge_all(scenes, runs, number, judges, options, f"{name}: features" if progress else None)
        new = [place for place, run in enumerate(runs) if number > 0 or run.variant == 0]
        boundaries = [runs[place].examples for place in new]
        samples = [draw_sample(one, rng, options) for one in boundaries]
        *of_parts, final = _fit_all(samples, of_run[new], parts, options, f"{name}: trees" if progress else None)
        rounds.append(final)
        scores = [
            torch.sigmoid(of_parts[parts.index(part)].score(one.values))
            for one, part in zip(boundaries, of_run[new].tolist(), strict=True)
        ]
        is_border = np.concatenate([one.is_border for one in boundaries])
        weight = np.concatenate([one.weight for one in boundaries])
        probability = torch.cat(scores).numpy()
        known = weight > 0
        calibrations.append(_calibration(probability[known], is_border[known], weight[known]))
        if report is not None:
            report(_scores(threshold, probability[known], is_border[known], weight[known]))
    return MemberModel(options.thresholds, FEATURE_NAMES, tuple(rounds), tuple(calibrations))


def _parts(rng: np.random.Generator, count: int, folds: int, kinds: Sequence[str] | None) -> NDArray[np.int64]:
    """The part of each scene: its kind, if there are several."""
    fold: NDArray[np.int64] = rng.permutation(count) % folds
    if kinds is not None and len(set(kinds)) > 1:
        fold = np.unique(np.asarray(kinds), return_inverse=True)[1]
    return fold


def _check_packages() -> None:
    with needed_for("training a model of boundaries", "scikit-learn", "torchjoint-lab"):
        import sklearn.ensemble  # noqa: F401
        import threadpoolctl  # noqa: F401


def trees_of_classifier(classifier: Any, bins: QuantileBins | None = None) -> BoostedTrees:
    """The trees of a fitted ``HistGradientBoostingClassifier`` of two classes, without categorical features.

    Args:
        classifier: fitted to values, or to the numbers of their bins.
        bins: in this case.
    """
    trees = [of_class[0].nodes for of_class in classifier._predictors]
    length = max(len(nodes) for nodes in trees)

    def padded(name: str, dtype: Any, padding: Any) -> Tensor:
        rows = [np.pad(nodes[name].astype(dtype), (0, length - len(nodes)), constant_values=padding) for nodes in trees]
        return torch.from_numpy(np.stack(rows))

    is_leaf = padded("is_leaf", bool, True)
    feature = padded("feature_idx", np.int32, 0).masked_fill(is_leaf, 0)
    threshold = padded("num_threshold", np.float64, 0).masked_fill(is_leaf, 0)
    if bins is not None:
        of_value = ~is_leaf & threshold.isfinite()
        found = bins.thresholds(feature[of_value].numpy(), threshold[of_value].numpy())
        threshold[of_value] = torch.from_numpy(found)
    # Where all that is known goes left, and what is missing right, scikit-learn's threshold is infinite.
    threshold = threshold.nan_to_num(posinf=torch.finfo(torch.float64).max)
    return BoostedTrees(
        feature=feature,
        threshold=threshold,
        missing_left=padded("missing_go_to_left", bool, False) & ~is_leaf,
        left=padded("left", np.int32, -1).masked_fill(is_leaf, -1),
        right=padded("right", np.int32, -1).masked_fill(is_leaf, -1),
        leaf_value=padded("value", np.float64, 0).masked_fill(~is_leaf, 0),
        baseline=float(classifier._baseline_prediction.item()),
    )


def _merge_all(
    scenes: Sequence[LabelledEvidence],
    runs: Sequence[SceneMerging],
    number: int,
    judges: Sequence[tuple[BoostedTrees, Tensor]] | None,
    options: BoundaryModelOptions,
    progress: str | None,
) -> None:
    """Brings all merges to a round, by the trees and calibration for each scene of the round before (None: no such)."""
    with tqdm(total=len(scenes), desc=progress, unit="scene", disable=progress is None) as bar:

        def merge(i: int) -> None:
            scene = scenes[i]  # read once for all its merges
            for run in runs:
                if run.scene == i and judges is None:
                    run.start(scene)
                elif run.scene == i and judges is not None:
                    run.advance(scene, number, *judges[i], options)
            bar.update()

        parallel_map(merge, range(len(scenes)))


def _fit_all(
    samples: Sequence[Sample],
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


def _grow(samples: Sequence[Sample], options: BoundaryModelOptions) -> BoostedTrees:
    """Boosted trees fitted to the rows of all samples; no tree at all if all rows have the same answer."""
    from sklearn.ensemble import HistGradientBoostingClassifier

    values, is_border, weight = join_samples(samples)
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
    bins = QuantileBins(values, weight)
    classifier.fit(bins.numbers(values), is_border, sample_weight=weight)
    return trees_of_classifier(classifier, bins)


def _constant(log_odds: float) -> BoostedTrees:
    none = torch.empty(0, 1)
    places = none.int()
    return BoostedTrees(places, none.double(), none.bool(), places, places, none.double(), log_odds)


def no_calibration() -> Tensor:
    """The calibration that changes nothing: [2, 2] float64."""
    return torch.tensor([[0.0, 1.0], [0.0, 1.0]], dtype=torch.float64)


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
