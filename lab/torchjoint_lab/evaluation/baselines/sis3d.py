"""Reads results of 3D-SIS: detections in voxels, a folder per scan, as its `main.py` writes them in test mode.

J. Hou, A. Dai, M. Niessner, "3D-SIS: 3D Semantic Instance Segmentation of RGB-D Scans" (CVPR 2019).

pred_box.npy      [K, 6] boxes in voxels of the scene: x y z x y z
pred_class.npy    [K] classes; 0 = background
pred_conf.npy     [K] confidences
pred_mask_index   pickle: K bools, True if a box is confident enough to have a mask
pred_mask         pickle: the masks of these boxes, [x, y, z] of 0 and 1; their sizes are the rounded boxes' sizes
scene.npy         the scene's occupied voxels, not used here

The benchmark mode of `main.py` writes the same files.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchjoint.datasets.files.readers import read_array
from torchjoint_lab.datasets.voxels import label_voxels, voxels_of
from torchjoint_lab.evaluation.baselines.pickled_arrays import read_pickled_arrays


class Detections(NamedTuple):
    """K detections; lengths are in voxels of the scene."""

    corners: Tensor  #: [K, 3] int64, the lowest voxel of each mask
    masks: tuple[Tensor, ...]  #: K of [x, y, z] bool
    scores: Tensor  #: [K] float64, confidence
    classes: Tensor  #: [K] int64


def read_detections(folder: Path) -> Detections:
    """Reads the detections of a result, except the background's.

    Raises:
        FileNotFoundError: a file is missing.
        ValueError: the message names the file and its error; also for files that do not fit each other.
    """
    boxes = read_array(folder / "pred_box.npy").double()
    if boxes.ndim != 2 or boxes.shape[1] < 6 or not (boxes.abs() < 2**31).all():  # NaN is rejected, too
        raise ValueError(f"{folder / 'pred_box.npy'}: expected boxes in voxels, [K, 6], got {list(boxes.shape)}")
    classes = _one_each(folder / "pred_class.npy", len(boxes)).long()
    scores = _one_each(folder / "pred_conf.npy", len(boxes)).double()
    has_mask = read_pickled_arrays(folder / "pred_mask_index")
    if len(has_mask) != len(boxes) or not all(isinstance(one, (bool, np.bool_)) for one in has_mask):
        raise ValueError(f"{folder / 'pred_mask_index'}: expected {len(boxes)} bools, one for each box")
    chosen = [k for k, one in enumerate(has_mask) if one]
    corners = boxes[chosen, :6].round().long()
    masks = _read_masks(folder / "pred_mask", corners[:, 3:] - corners[:, :3])
    kept = [i for i, k in enumerate(chosen) if classes[k] != 0]
    of_kept = [chosen[i] for i in kept]
    return Detections(corners[kept, :3], tuple(masks[i] for i in kept), scores[of_kept], classes[of_kept])


def detection_labels(detections: Detections, points: Tensor, world_to_scene: Tensor) -> Tensor:
    """Converts detections to point labels: a point gets the detection whose mask contains the point's voxel.

    Args:
        detections: K detections.
        points: [N, 3] metres, world frame.
        world_to_scene: [4, 4], see :func:`torchjoint_lab.datasets.voxels.read_world_to_scene`.

    Returns:
        [N] int64: of several detections the most confident one, then the first; -1 where nothing was detected, that is
        outside of the paper's set P_D.
    """
    weakest_first = sorted(range(len(detections.masks)), key=lambda k: (float(detections.scores[k]), -k))
    return label_voxels(voxels_of(points, world_to_scene), detections.corners, detections.masks, weakest_first)


def _one_each(path: Path, count: int) -> Tensor:
    values = read_array(path)
    if values.shape != (count,) or values.is_complex() or values.isnan().any():
        raise ValueError(f"{path}: expected {count} numbers, one for each box, got shape {list(values.shape)}")
    return values


def _read_masks(path: Path, sizes: Tensor) -> list[Tensor]:
    masks = read_pickled_arrays(path)
    if len(masks) != len(sizes):
        raise ValueError(f"{path}: expected {len(sizes)} masks, one for each box that has one, got {len(masks)}")
    for k, (mask, size) in enumerate(zip(masks, sizes.tolist(), strict=True)):
        if not isinstance(mask, np.ndarray) or list(mask.shape) != size:
            raise ValueError(f"{path}: expected mask {k} to have its box's size {size}, got {list(np.shape(mask))}")
    return [torch.from_numpy(mask != 0) for mask in masks]
