"""Predicted instances in the files of ScanNet's benchmark: masks that may overlap, each with a score.

Two layouts are common. The benchmark's has a file for each scene, with lines ``predicted_masks/NAME.txt label score``,
and one 0 or 1 for each vertex in each mask's file. The other is one archive, with the arrays ``pred_masks`` [N, K],
``pred_score`` [K] and ``pred_classes`` [K]. Classes are not used: the instances are class-agnostic.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path, PurePosixPath
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchjoint.masks.arrays import as_binary
from torchjoint.runtime.archives import read_archive
from torchjoint.runtime.foreign_files import open_file, present, read_text

#: Largest number of masks of a scene.
MOST = 100_000


class Instances(NamedTuple):
    """K instances of a cloud."""

    points: Sequence[Tensor]  #: K x [M] int64, the points of each mask, ascending
    scores: Tensor  #: [K] float64


def is_listing(path: Path) -> bool:
    """Whether a .txt file lists masks; one with a label for each point has numbers only."""
    with open_file(path) as stream:
        start = stream.read(1 << 16).decode("utf-8", "replace")
    words = next((line.split() for line in start.splitlines() if line.strip()), [])
    return len(words) == 3 and words[0].endswith(".txt")


def read_instances(path: Path, num_points: int) -> Instances:
    """Reads the instances of a scene from either layout.

    Args:
        path: a .txt file that lists masks, or an .npz archive.
        num_points: of the scene, to which each mask must fit.

    Raises:
        FileNotFoundError, ValueError: the message names the file and its error.
    """
    return _of_archive(path, num_points) if path.suffix == ".npz" else _of_listing(path, num_points)


def painted(instances: Instances, num_points: int) -> Tensor:
    """One label for each point, [N] int64: of overlapping instances the one with the highest score; -1: in none.

    Of equal scores, the instance that comes first is on top.
    """
    labels = torch.full((num_points,), -1)
    order = torch.sort(instances.scores, descending=True, stable=True).indices.flip(0)
    for index in order.tolist():
        labels[instances.points[index]] = index
    return labels


def _of_archive(path: Path, num_points: int) -> Instances:
    arrays = read_archive(path, ("pred_masks", "pred_score", "pred_scores"))
    masks, scores = arrays.get("pred_masks"), arrays.get("pred_score", arrays.get("pred_scores"))
    if masks is None or scores is None:
        raise ValueError(
            f"{path}: expected arrays pred_masks and pred_score, got {', '.join(arrays) or 'none of them'}"
        )
    if masks.ndim != 2 or len(masks) != num_points:
        raise ValueError(f"{path}: pred_masks: expected shape [{num_points}, K], got {list(masks.shape)}")
    inside = as_binary(masks.T, f"{path}: pred_masks")
    return _checked([mask.nonzero()[:, 0] for mask in inside], scores, str(path))


def _of_listing(path: Path, num_points: int) -> Instances:
    points: list[Tensor] = []
    scores: list[float] = []
    for number, line in enumerate(read_text(path, "a list of instances", errors="replace").splitlines(), 1):
        words, where = line.split(), f"{path}, line {number}"
        if not words:
            continue
        if len(words) != 3 or len(points) == MOST:
            raise ValueError(f"{where}: expected at most {MOST} masks, as `FILE label score`, got {line[:100]!r}")
        place = PurePosixPath(words[0])
        if place.is_absolute() or ".." in place.parts:
            raise ValueError(f"{where}: expected a file below {path.parent}, got {words[0]!r}")
        try:
            scores.append(float(words[2]))
        except ValueError as error:
            raise ValueError(f"{where}: expected a number as score, got {words[2]!r}") from error
        points.append(_read_mask(path.parent / place, num_points))
    return _checked(points, np.array(scores), str(path))


def _read_mask(file: Path, num_points: int) -> Tensor:
    present(file, "a mask")
    if file.stat().st_size > 32 * (num_points + 1):
        raise ValueError(f"{file}: expected 0 or 1 for each of {num_points} points, got {file.stat().st_size} bytes")
    try:
        mask = np.array(read_text(file, "a mask").split(), dtype=np.float64)
    except ValueError as error:
        raise ValueError(f"{file}: expected 0 or 1 for each point: {error}") from error
    if len(mask) != num_points:
        raise ValueError(f"{file}: expected 0 or 1 for each of {num_points} points, got {len(mask)} numbers")
    return as_binary(mask, str(file)).nonzero()[:, 0]


def _checked(points: Sequence[Tensor], scores: npt.NDArray[np.float64], name: str) -> Instances:
    if scores.shape != (len(points),) or scores.dtype.kind not in "fiu" or not np.isfinite(scores).all():
        raise ValueError(f"{name}: expected a finite score for each of {len(points)} masks, got {list(scores.shape)}")
    return Instances(points, torch.from_numpy(scores.astype(np.float64)))
