"""The volumes of 3D-SIS, whole scenes (`.scene`) or pieces (`.chunk`): a distance field and the objects in it.

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

from torchjoint.datasets.binary import BinaryFile


@dataclass(frozen=True)
class Volume:
    """A volume; lengths are in voxels of 0.046875 m, y is up.

    Attributes:
        sdf: [X, Y, Z] float32, signed distance to the nearest surface; -inf = never seen.
        boxes: [K, 6] float32, lowest and highest corner (x y z x y z) of each object.
        classes: [K] int64, NYU40 classes.
        masks: K of [x, y, z] int64, from the box's lowest corner rounded down: 0 = not the object, 1 = its surface as
            seen, more = what only the complete object has.
        inside: [K] float32, the share of each box that lies in the volume.
        voxels_to_world: [4, 4] float64. The file calls it world-to-chunk, but holds its inverse, as written and read by
            3D-SIS. Its scenes' world is turned y up and moved: use `world2grid.txt` for them.
        frame_ids: [F] int64, the images that see it best.
    """

    sdf: Tensor
    boxes: Tensor
    classes: Tensor
    masks: tuple[Tensor, ...]
    inside: Tensor
    voxels_to_world: Tensor
    frame_ids: Tensor

    @property
    def dims(self) -> tuple[int, int, int]:
        """(X, Y, Z), voxels."""
        x, y, z = self.sdf.shape
        return x, y, z

    @property
    def world_to_chunk(self) -> Tensor:
        """[4, 4] float64. Raises ValueError where it cannot be told."""
        inverse, error = torch.linalg.inv_ex(self.voxels_to_world)
        if error.item() or not torch.isfinite(inverse).all():
            raise ValueError(f"voxels_to_world: expected an invertible transform, got {self.voxels_to_world.tolist()}")
        return inverse

    @property
    def corners(self) -> Tensor:
        """[K, 3] int64, the lowest voxel of each mask."""
        return self.boxes[:, :3].floor().long()


def read_volume(path: Path) -> Volume:
    """Reads a `.scene` or `.chunk` file.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: truncated, counts that do not fit the file, or boxes that are none.
    """
    with BinaryFile(path) as file:
        sdf = _x_fastest(file, "<f4")
        boxes = file.array([("box", "<f4", 6), ("label", "<u4")], _count(file))
        if not (np.abs(boxes["box"]) < 2**31).all():  # NaN, too
            raise ValueError(f"{path}: expected boxes in voxels, got {boxes['box'].tolist()}")
        num_masks = _count(file)
        if num_masks != len(boxes):
            raise ValueError(f"{path}: expected a mask for each of {len(boxes)} boxes, got {num_masks}")
        masks = []
        for _ in range(num_masks):
            file.skip(4)  # the label once more
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
    """Three lengths and as many numbers -> [X, Y, Z]."""
    x, y, z = file.read("3Q")
    if max(x, y, z) > file.size:  # an empty volume may claim any length
        raise ValueError(f"{file.path}: expected a volume that the file can hold, got {x} x {y} x {z} voxels")
    return file.array(dtype, x * y * z).reshape(z, y, x).transpose(2, 1, 0).copy()
