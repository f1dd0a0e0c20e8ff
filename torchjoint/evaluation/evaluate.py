"""A prediction against a scene's truth."""

from __future__ import annotations

from torchjoint.evaluation.predictions import Prediction
from torchjoint.evaluation.scores import score, score_images
from torchjoint.evaluation.table import Row
from torchjoint.scene import Scene


def evaluate(prediction: Prediction, scene: Scene, name: str, method: str = "") -> list[Row]:
    """The rows of one scene: 3D where both know points, 2D where both know images.

    Raises:
        ValueError: the scene has no truth, or none of what was predicted.
    """
    truth = scene.truth
    if truth is None:
        raise ValueError(f"{name}: the scene comes without truth, there is nothing to compare with")
    rows = []
    if prediction.points is not None and truth.points is not None:
        rows.append(Row(name, method, "3D", score(prediction.points, truth.points[prediction.of_points])))
    if len(prediction.images) and len(truth.images):
        if len(truth.images) != len(scene.frames):
            raise ValueError(f"{name}: {len(truth.images)} truths for {len(scene.frames)} frames")
        in_2d = score_images(prediction.images, [truth.images[index] for index in prediction.of_frames])
        rows += [Row(name, method, "2D", in_2d)] if in_2d else []
    if not rows:
        raise ValueError(f"{name}: what is predicted (points, images) is not what there is truth for")
    return rows
