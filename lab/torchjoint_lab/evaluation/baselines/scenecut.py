"""Reads SceneCut's image segmentations: one map per image, of its size; each distinct value is a region, 0 = none.

T. Pham et al., "SceneCut: Joint Geometric and Object Segmentation for Indoor Scenes" (ICRA 2018).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchjoint.datasets.files.mat_files import read_matrices
from torchjoint.datasets.files.readers import read_array
from torchjoint.runtime.bounds import PIXELS

SUFFIXES = (".mat", ".npy")


def read_region_map(path: Path) -> Tensor:
    """Reads a map: a .npy file, or the only numeric matrix of a .mat file (versions 5 to 7).

    Returns:
        [H, W] int64: regions 0, 1, ... by ascending value, -1 = none.

    Raises:
        FileNotFoundError, ValueError: the message names the file and its error.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path}: missing; expected a map of regions, .mat or .npy")
    values = read_array(path).numpy() if path.suffix == ".npy" else _read_mat(path)
    if values.ndim != 2 or not values.size or values.dtype.kind not in "biuf" or not np.isfinite(values).all():
        raise ValueError(f"{path}: expected finite numbers of shape [H, W], got {values.dtype} {list(values.shape)}")
    regions = values != 0
    labels = np.full(values.shape, -1, dtype=np.int64)
    labels[regions] = np.unique(values[regions], return_inverse=True)[1]
    return torch.from_numpy(labels)


def find_region_map(folder: Path, name: str) -> Path:
    """Finds the map of a frame, NAME.mat or NAME.npy.

    Raises:
        FileNotFoundError: there is no map.
        ValueError: there are two maps.
    """
    found = [file for suffix in SUFFIXES if (file := folder / f"{name}{suffix}").is_file()]
    if not found:
        raise FileNotFoundError(f"{folder / name}.mat: missing, and so is {name}.npy; expected a map of regions")
    if len(found) > 1:
        raise ValueError(f"{folder}: holds both {name}.mat and {name}.npy; remove one")
    return found[0]


def _read_mat(path: Path) -> npt.NDArray[Any]:
    matrices = read_matrices(path, PIXELS)
    if len(matrices) != 1:
        raise ValueError(f"{path}: expected one matrix of numbers, got {', '.join(matrices) or 'none'}")
    return matrices.popitem()[1]
