"""The viewer's layers that are not of a result: a scene's truth, and superpoints of a file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchjoint.datasets.files.clouds import read_cloud_file
from torchjoint.datasets.files.las import las_chunks, open_las
from torchjoint.datasets.files.ply import read_vertex_property
from torchjoint.results.result import Result
from torchjoint.runtime.archives import read_archive
from torchjoint.scene import Scene, Segmentation, Truth
from torchjoint.transforms import transfer_labels


def with_truth(result: Result, scene: Scene) -> Result:
    """Adds the truth of a scene to a result, in the order of the result's points and images.

    Args:
        result: of the scene, or of some of its points and frames.
        scene: the scene with its truth.
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


def read_labelled_cloud(path: Path) -> Result:
    """Reads a .ply with `label`, a .las or .laz with `label` or `superpoint`, or a .npz with points and labels."""
    cloud = read_cloud_file(path)
    labels = _labels(path)
    if labels is None or len(labels) != len(cloud.points):
        wanted = "a .ply with `label`, a .las or .laz with `label` or `superpoint`, or a .npz with `labels`"
        raise ValueError(f"{path}: expected {wanted}, got no labels")
    numbered = np.unique(labels, return_inverse=True)[1]
    colors = None if path.suffix == ".ply" else cloud.colors  # those of a .ply are of its segments
    scene = Scene(cloud.points, colors=colors, name=path.stem)
    return Result.of(Segmentation(torch.from_numpy(numbered.astype(np.int64)), ()), scene)


def _labels(path: Path) -> npt.NDArray[np.int64] | None:
    if path.suffix == ".npz":
        labels = read_archive(path).get("labels")
        return None if labels is None else labels.astype(np.int64)
    if path.suffix.lower() in (".las", ".laz"):
        with open_las(path) as reader:
            found = set(reader.header.point_format.extra_dimension_names) & {"label", "superpoint"}
            chunks = [np.asarray(chunk[min(found)]) for chunk in las_chunks(reader, path)] if found else []
        return np.concatenate(chunks).astype(np.int64) if chunks else None
    return read_vertex_property(path, "label") if path.suffix == ".ply" else None
