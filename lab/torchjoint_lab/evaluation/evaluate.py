"""Scores a prediction against the ground truth of a scene."""

from __future__ import annotations

import warnings

from scipy.spatial import cKDTree
from torch import Tensor

from torchjoint.scene import Scene
from torchjoint_lab.evaluation.levels import score_levels
from torchjoint_lab.evaluation.partial_truth import knows, knows_points
from torchjoint_lab.evaluation.predictions import Prediction
from torchjoint_lab.evaluation.scores import Scores, score, score_images
from torchjoint_lab.evaluation.table import Row


def evaluate(prediction: Prediction, scene: Scene, name: str, method: str = "") -> list[Row]:
    """Scores one scene; returns a row for 3D if both have point labels, and one for 2D if both have label images.

    Raises:
        ValueError: the scene has no ground truth for the predicted points or images, or sizes do not fit.
    """
    truth = scene.truth
    if truth is None or not knows(truth):
        raise ValueError(f"{name}: expected a scene with ground truth, got one without")
    rows = []
    if prediction.points is not None and truth.points is not None:
        known = truth.select_points(prediction.of_points)
        if known.points is not None and knows_points(known):
            _tell_other_order(scene.points[prediction.of_points], known.points, name)
            rows.append(Row(name, method, "3D", score(prediction.points, known.points)))
    if len(prediction.images) and len(truth.images):
        if len(truth.images) != len(scene.frames):
            raise ValueError(f"{name}: expected {len(scene.frames)} truths of images, got {len(truth.images)}")
        try:
            in_2d = score_images(prediction.images, truth.select_frames(prediction.of_frames).images)
        except ValueError as error:
            raise ValueError(f"{name}, images in the order of their names: {error}") from error
        rows += [Row(name, method, "2D", in_2d)] if in_2d else []
    if not rows:
        raise ValueError(f"{name}: expected ground truth for the predicted points or images, got none")
    return rows


def _tell_other_order(points: Tensor, labels: Tensor, name: str) -> None:
    """Warns if neighbours share their label little more often than two points by chance: the order is another one."""
    sample = points[:: 1 + len(points) // 2000], labels[:: 1 + len(points) // 2000]
    _, near = cKDTree(points).query(sample[0], k=2)
    agreement = (labels[near[:, 0]] == labels[near[:, 1]]).double().mean()
    by_chance = (labels.unique(return_counts=True)[1] / len(labels)).square().sum()
    if len(points) > 100 and agreement < 0.5 * (1 + by_chance):
        warnings.warn(f"{name}: neighbours rarely have one truth: is it in the order of the points?", stacklevel=3)


def evaluate_levels(prediction: Prediction, scene: Scene) -> list[Scores]:
    """Returns the 3D scores at :data:`~torchjoint_lab.evaluation.levels.GRANULARITIES`.

    The list is empty if the prediction has no hierarchy, or the scene has no ground truth for its points.
    """
    truth = scene.truth
    if prediction.hierarchy is None or truth is None or truth.points is None:
        return []
    known = truth.select_points(prediction.of_points)
    return score_levels(prediction.hierarchy, known.points) if known.points is not None and knows_points(known) else []


def left_out(prediction: Prediction, scene: Scene) -> str:
    """Describes the points and images of the scene without prediction, which are not scored; empty if none."""
    parts = []
    if prediction.points is not None and len(prediction.points) < len(scene.points):
        parts.append(f"{len(prediction.points)} of {len(scene.points)} points")
    if len(prediction.images) and len(prediction.images) < len(scene.frames):
        parts.append(f"{len(prediction.images)} of {len(scene.frames)} images")
    return " and ".join(parts)
