"""Labels points by instance masks on voxels: the format of ground truth and results in 3D-SIS.

Voxel (i, j, k) is the cube of side 1 centred at grid position (i, j, k); rounding a point's position gives its voxel.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor

from torchjoint.datasets.files.readers import read_matrix

#: Padding of 3D-SIS' complete grids, voxels; its scenes do not have this padding.
SCENE_PADDING = (10, 16, 10)

#: Positions beyond this are outside of any volume, and would overflow integers.
_FAR = 2**31


def read_world_to_scene(path: Path) -> Tensor:
    """Reads `world2grid.txt`; returns the transform from world to the scene's voxels, [4, 4] float64, y up.

    The file's grid has additional padding; the returned transform removes this padding.

    Raises:
        FileNotFoundError, ValueError: the message names the file and its error.
    """
    matrix = read_matrix(path, (4, 4))
    if not torch.isfinite(matrix).all() or matrix[3].tolist() != [0, 0, 0, 1] or torch.linalg.det(matrix) == 0:
        raise ValueError(f"{path}: expected an affine transform [A t; 0 1], got {matrix.tolist()}")
    matrix[:3, 3] -= torch.tensor(SCENE_PADDING)
    return matrix


def voxels_of(points: Tensor, world_to_voxels: Tensor) -> Tensor:
    """Returns the voxel [N, 3] int64 of each point [N, 3]."""
    places = points.double() @ world_to_voxels[:3, :3].T + world_to_voxels[:3, 3]
    return places.round().clamp(-_FAR, _FAR).long()


def label_voxels(voxels: Tensor, corners: Tensor, masks: Sequence[Tensor], order: Sequence[int]) -> Tensor:
    """Finds the mask that contains each voxel.

    Args:
        voxels: [N, 3] int64.
        corners: [K, 3] int64, the lowest voxel of each mask.
        masks: K of [x, y, z] bool.
        order: indices of the masks, from lowest to highest priority: the last mask in `order` wins.

    Returns:
        [N] int64, index into `masks`; -1 = in no mask.
    """
    labels = torch.full((len(voxels),), -1)
    for k in order:
        local = voxels - corners[k]
        (inside,) = ((local >= 0) & (local < torch.tensor(masks[k].shape))).all(1).nonzero(as_tuple=True)
        x, y, z = local[inside].unbind(1)
        labels[inside[masks[k][x, y, z]]] = k
    return labels
