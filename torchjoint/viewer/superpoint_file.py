"""Reads a labelled cloud, such as `torchjoint superpoints` writes, as a result for the viewer."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch

from torchjoint.datasets.files.clouds import read_cloud_file
from torchjoint.datasets.files.ply import read_vertex_property
from torchjoint.results.result import Result
from torchjoint.runtime.archives import read_archive
from torchjoint.scene import Scene, Segmentation


def read_labelled_cloud(path: Path) -> Result:
    """Reads a .ply with the property `label`, or a .npz with the arrays points and labels.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is damaged, or has no labels; the message names the file.
    """
    cloud = read_cloud_file(path)
    labels = _labels(path)
    if labels is None or len(labels) != len(cloud.points):
        raise ValueError(f"{path}: expected a .ply with the property `label`, or a .npz with `labels`, got no labels")
    numbered = np.unique(labels, return_inverse=True)[1]
    scene = Scene(cloud.points, colors=cloud.colors if path.suffix == ".npz" else None, name=path.stem)
    return Result.of(Segmentation(torch.from_numpy(numbered.astype(np.int64)), ()), scene)


def _labels(path: Path) -> npt.NDArray[np.int64] | None:
    if path.suffix == ".npz":
        labels = read_archive(path).get("labels")
        return None if labels is None else labels.astype(np.int64)
    return read_vertex_property(path, "label") if path.suffix == ".ply" else None
