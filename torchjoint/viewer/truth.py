"""The ground truth of a recording beside its result."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from torchjoint.datasets import load_scene
from torchjoint.results.result import Result
from torchjoint.scene import Truth
from torchjoint.transforms import transfer_labels


def with_truth(result: Result, recording: Path, cloud: Path | None = None) -> Result:
    """The result with the truth of its recording, in the order of the result's points and images.

    Args:
        result: of the recording, or of some of its points and frames.
        recording: path of the scene.
        cloud: the fused cloud, if the recording has none.

    Raises:
        FileNotFoundError: the recording is not there.
        ValueError: it has no truth.
    """
    if not recording.exists():
        raise FileNotFoundError(f"--truth: the recording {recording} of this result is no longer there")
    scene = load_scene(recording, cloud=cloud)
    if scene.truth is None:
        raise ValueError(f"--truth: {recording} has no ground truth")
    points = scene.truth.points
    if points is not None and not (
        len(points) == len(result.points) and torch.equal(scene.points, result.scene.points)
    ):
        points = transfer_labels(points, scene.points, result.scene.points)
    images: list[Tensor] = []
    if len(scene.truth.images):
        place = {frame.name: index for index, frame in enumerate(scene.frames)}
        if missing := [name for name in result.names if name not in place]:
            raise ValueError(f"--truth: {recording} has no frame {missing[0]!r}")
        images = [scene.truth.images[place[name]] for name in result.names]
    return replace(result, scene=replace(result.scene, truth=Truth(points, images)))
