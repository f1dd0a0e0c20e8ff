"""Reads the volumes of 3D-SIS, scenes (`.scene`) or chunks (`.chunk`): a signed distance field and its objects.

J. Hou, A. Dai, M. Niessner, "3D-SIS: 3D Semantic Instance Segmentation of RGB-D Scans" (CVPR 2019).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchjoint.datasets.files.binary import BinaryFile


@dataclass(frozen=True)
class Volume:
    """A volume; lengths are in voxels of 0.046875 m, y is up.

    Attributes:
        sdf: [X, Y, Z] float32, signed distance to the nearest surface; -inf = never seen.
        boxes: [K, 6] float32, lowest and highest corner (x y z x y z) of each object.
        classes: [K] int64, NYU40 classes.
        masks: K of [x, y, z] int64, starting at the box's lowest corner rounded down: 0 = not the object, 1 = its seen
            surface, above 1 = unseen parts of the complete object.
        inside: [K] float32, the share of each box that lies in the volume.
        voxels_to_world: [4, 4] float64. The file calls it world-to-chunk, but 3D-SIS writes and reads its inverse. In
            scenes, the world frame is rotated (y up) and shifted: use `world2grid.txt` for scenes.
        frame_ids: [F] int64, the images that see the volume best.
    """

    sdf: Tensor
    boxes: Tensor
    classes: Tensor
    masks: tuple[Tensor, ...]
    inside: Tensor
    voxels_to_world: Tensor
    frame_ids: Tensor

    @property
    def corners(self) -> Tensor:
        """The lowest voxel of each mask, [K, 3] int64."""
        return self.boxes[:, :3].floor().long()


def read_volume(path: Path) -> Volume:
    """Reads a `.scene` or `.chunk` file.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: a truncated file, counts that do not fit the file, or invalid boxes.
    """
    with BinaryFile(path) as file:
        sdf = _x_fastest(file, "<f4")
        boxes = file.array([("box", "<f4", 6), ("label", "<u4")], _count(file))
        if not (np.abs(boxes["box"]) < 2**31).all():  # NaN is rejected, too
            raise ValueError(f"{path}: expected boxes in voxels, got {boxes['box'].tolist()}")
        num_masks = _count(file)
        if num_masks != len(boxes):
            raise ValueError(f"{path}: expected a mask for each of {len(boxes)} boxes, got {num_masks}")
        masks = []
        for _ in range(num_masks):
            file.skip(4)  # skips a second copy of the label
            masks.append(torch.from_numpy(_x_fastest(file, "<u2").astype(np.int64)))
        return Volume(
            torch.from_numpy(sdf),
            torch.from_numpy(np.ascontiguousarray(boxes["box"])),
            torch.from_numpy(boxes["label"].astype(np.int64)),
            tuple(masks),
            torch.from_numpy(file.array("<f4", _count(file))),
            torch.from_numpy(file.array("<f4", 16).astype(np.float64).reshape(4, 4)),
            torch.from_numpy(file.array("<u4", _count(file)).astype(np.int64)),
        )


def _count(file: BinaryFile) -> int:
    return int(file.read("I")[0])


def _x_fastest(file: BinaryFile, dtype: str) -> npt.NDArray[Any]:
    """Reads three lengths and X * Y * Z numbers; returns [X, Y, Z]."""
    x, y, z = file.read("3Q")
    if max(x, y, z) > file.size:  # an empty volume may claim any length
        raise ValueError(f"{file.name}: expected at most {file.size} voxels a side, got {x} x {y} x {z}")
    return file.array(dtype, x * y * z).reshape(z, y, x).transpose(2, 1, 0).copy()
