"""Reads predicted segmentations from disk; evaluation compares them with a scene's ground truth."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchjoint.cli.output import tell_of_edits
from torchjoint.datasets.files.readers import read_array, read_label_image
from torchjoint.results.folder import read_points
from torchjoint.results.manifest import HIERARCHY, read_hierarchy
from torchjoint.runtime.files import frame_files
from torchjoint.runtime.foreign_files import has_file, has_folder, read_text
from torchjoint.runtime.threads import LazySequence, parallel_map
from torchjoint.scene import Hierarchy, Scene, Segmentation
from torchjoint.scene.checks import as_labels
from torchjoint_lab.evaluation.instances import Instances, is_listing, painted, read_instances

#: Largest distance between a result's point and its scene point, metres.
NEAR = 1e-3


class Prediction(NamedTuple):
    """Predicted labels of a scene, and the points and frames to which they belong."""

    points: Tensor | None  #: [M] int64
    of_points: Tensor  #: [M] int64, indices of the scene's points
    images: Sequence[Tensor]  #: label images [H, W]
    of_frames: Sequence[int]  #: indices of the scene's frames
    hierarchy: Hierarchy | None = None  #: all levels of the M points, if the method makes them
    scores: Tensor | None = None  #: [S] float64, the confidence in each label
    instances: Instances | None = None  #: masks that may overlap; the labels are then those of the best of them


def is_result(path: Path) -> bool:
    """Returns whether a path is one prediction, not a folder of several."""
    return has_file(path) or has_file(path / "points.npz") or has_folder(path / "images")


def read_prediction(path: Path, scene: Scene) -> Prediction:
    """Reads a segmentation of a scene.

    Args:
        path: a folder that `torchjoint segment` wrote; or the labels of all points, as a .npy of integers [N] or a .txt
            with one number per line; or instances as in ScanNet's benchmark, see
            :mod:`torchjoint_lab.evaluation.instances`; or a folder with an image `images/NAME.png` for each frame NAME,
            which holds label + 1 in 8 or 16 bits.
        scene: the segmented scene.

    Raises:
        FileNotFoundError, ValueError, TypeError: the message names the file and its error.
    """
    if has_file(path):
        if path.suffix == ".npz" or (path.suffix == ".txt" and is_listing(path)):
            found = read_instances(path, len(scene.points))
            labels = painted(found, len(scene.points))
            return Prediction(labels, torch.arange(len(labels)), (), (), None, found.scores, found)
        labels = _read_labels(path)
        return Prediction(as_labels(labels, (len(scene.points),), str(path)), torch.arange(len(labels)), (), ())
    if not has_folder(path):
        raise FileNotFoundError(f"{path}: missing; expected a result of `torchjoint segment`, or labels")
    points, of_points, hierarchy, scores = None, torch.empty(0, dtype=torch.int64), None, None
    if has_file(path / "points.npz"):
        tell_of_edits(path, "scores leave corrections by hand out; `torchjoint export --format masks` has them")
        result = read_points(path)
        points, of_points = result.labels, _places(result.points, scene.points, path / "points.npz")
        hierarchy = read_hierarchy(path, len(points)) if has_file(path / HIERARCHY) else None
        scores = Segmentation(points, (), hierarchy=hierarchy).confidence
    files = sorted((path / "images").glob("*.png")) if has_folder(path / "images") else []
    if points is None and not files:
        raise FileNotFoundError(f"{path}: has neither points.npz nor images/*.png; expected a result")
    names = _frame_names(scene) if files else {}
    unknown = [file for file in files if file.stem not in names]
    if unknown:
        raise ValueError(f"{unknown[0]}: the scene has no frame of that name; it has {', '.join(list(names)[:3])} ...")
    of_frames = [names[file.stem] for file in files]
    images = LazySequence(len(files), lambda index: read_label_image(files[index]) - 1)
    return Prediction(points, of_points, images, of_frames, hierarchy, scores)


def _frame_names(scene: Scene) -> dict[str, int]:
    """Indices of the frames by the names of their files in a result."""
    known = getattr(scene.frames, "names", ())  # avoids reading lazy frames
    found = known or parallel_map(lambda index: scene.frames[index].name, range(len(scene.frames)))
    names = frame_files(found)
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"{scene.name}: expected different names of frames, got {twice!r} twice")
    return {name: index for index, name in enumerate(names)}


def _read_labels(path: Path) -> Tensor:
    if path.suffix == ".npy":
        return read_array(path)
    if path.suffix != ".txt":
        raise ValueError(f"{path}: expected labels of points, .npy or .txt, instances, .npz or .txt, or a result")
    try:
        return torch.from_numpy(np.array(read_text(path, "labels").split(), dtype=np.int64))
    except (ValueError, OverflowError) as error:
        raise ValueError(f"{path}: expected a whole number for each point, got {error}") from error


def _places(points: Tensor, of: Tensor, file: Path) -> Tensor:
    """For each point of the result, the index of the same point in the scene, which may have more, in another order."""
    if points.shape == of.shape and torch.equal(points, of):
        return torch.arange(len(of))
    from scipy.spatial import cKDTree

    distance, index = cKDTree(of.double().numpy()).query(points.double().numpy())
    if float(distance.max(initial=0.0)) > NEAR:
        raise ValueError(
            f"{file}: expected points of the scene, got one that is {distance.max():.3g} m from all of them; "
            "was the cloud fused with another --voxel-size?"
        )
    return torch.from_numpy(index)
