"""Instances as boxes of voxels, and the points that lie in them: how 3D-SIS writes both truth and results.

A voxel (i, j, k) is the cube of side 1 around that place of the grid, so a point's voxel is its place rounded.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor

from torchjoint.datasets.files import read_matrix

#: Padding of 3D-SIS' whole grids that its scenes leave out, voxels.
SCENE_PADDING = (10, 16, 10)

#: Places beyond are outside of any volume, and would overflow integers.
_FAR = 2**31


def read_world_to_scene(path: Path) -> Tensor:
    """World to voxels of the scene [4, 4] float64, y up, of a `world2grid.txt`, whose grid is padded more.

    Raises:
        FileNotFoundError, ValueError: naming the file and what is wrong with it.
    """
    matrix = read_matrix(path, (4, 4))
    if not torch.isfinite(matrix).all() or matrix[3].tolist() != [0, 0, 0, 1] or torch.linalg.det(matrix) == 0:
        raise ValueError(f"{path}: expected an affine transform [A t; 0 1], got {matrix.tolist()}")
    matrix[:3, 3] -= torch.tensor(SCENE_PADDING)
    return matrix


def voxels_of(points: Tensor, world_to_voxels: Tensor) -> Tensor:
    """The voxel [N, 3] int64 that each point [N, 3] lies in."""
    places = points.double() @ world_to_voxels[:3, :3].T + world_to_voxels[:3, 3]
    return places.round().clamp(-_FAR, _FAR).long()


def label_voxels(voxels: Tensor, corners: Tensor, masks: Sequence[Tensor], order: Sequence[int]) -> Tensor:
    """Which mask each voxel is in.

    Args:
        voxels: [N, 3] int64.
        corners: [K, 3] int64, the lowest voxel of each mask.
        masks: K of [x, y, z] bool.
        order: of the masks from the weakest to the strongest: a voxel in several is the last one's.

    Returns:
        [N] int64, places in `masks`, -1 = in none.
    """
    labels = torch.full((len(voxels),), -1)
    for k in order:
        local = voxels - corners[k]
        (inside,) = ((local >= 0) & (local < torch.tensor(masks[k].shape))).all(1).nonzero(as_tuple=True)
        x, y, z = local[inside].unbind(1)
        labels[inside[masks[k][x, y, z]]] = k
    return labels
