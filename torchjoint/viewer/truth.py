"""Adds the ground truth of a scene to its result."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from torchjoint.results.result import Result
from torchjoint.scene import Scene, Truth
from torchjoint.transforms import transfer_labels


def with_truth(result: Result, scene: Scene) -> Result:
    """Adds the truth of a scene to a result, in the order of the result's points and images.

    Args:
        result: of the scene, or of some of its points and frames.
        scene: the scene with its truth.

    Raises:
        ValueError: the scene has no truth, or lacks a frame of the result.
    """
    if scene.truth is None:
        raise ValueError(f"--truth: expected a scene with ground truth, got {scene.name} without")
    points = scene.truth.points
    if points is not None and not (
        len(points) == len(result.points) and torch.equal(scene.points, result.scene.points)
    ):
        points = transfer_labels(points, scene.points, result.scene.points)
    images: list[Tensor] = []
    if len(scene.truth.images):
        place = {frame.name: index for index, frame in enumerate(scene.frames)}
        if missing := [name for name in result.names if name not in place]:
            raise ValueError(f"--truth: {scene.name} has no frame {missing[0]!r}")
        images = [scene.truth.images[place[name]] for name in result.names]
    return replace(result, scene=replace(result.scene, truth=Truth(points, images)))
