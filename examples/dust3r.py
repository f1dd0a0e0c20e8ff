"""Hands what DUSt3R or MASt3R makes of images to torchjoint, which then segments its points and images together.

In their program, behind the global alignment:

    from dust3r import save                       # this file
    save(scene, "room/predictions.npz")           # what global_aligner or sparse_global_alignment returned

and then `torchjoint segment room`, or `tj.load_scene("room")`. The images must have one size. Written against the code
of both in 2025, and tried with objects that answer as theirs do; the networks themselves were not run, because their
licence is for research only.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt


def save(scene: Any, file: str | Path) -> None:
    """Writes cameras and depth of an aligned scene in the layout of VGGT's demo, which `tj.load_scene` reads.

    Args:
        scene: has `imgs`, `get_focals`, `get_principal_points` and `get_im_poses`; and `get_dense_pts3d` (MASt3R), or
            `get_depthmaps` and `im_conf` (DUSt3R).
        file: must be named predictions.npz.
    """
    images = np.stack([np.asarray(image, np.float32) for image in scene.imgs])  # [S, H, W, 3] RGB in [0, 1]
    count, height, width, _ = images.shape
    intrinsics = np.tile(np.eye(3), (count, 1, 1))
    intrinsics[:, 0, 0] = intrinsics[:, 1, 1] = _array(scene.get_focals()).reshape(count)
    intrinsics[:, :2, 2] = _array(scene.get_principal_points())
    if hasattr(scene, "get_dense_pts3d"):
        _, depth, sure = scene.get_dense_pts3d()
    else:
        depth, sure = scene.get_depthmaps(), scene.im_conf
    depth, sure = (np.stack([_array(one).reshape(height, width) for one in maps]) for maps in (depth, sure))
    world_to_camera = np.linalg.inv(_array(scene.get_im_poses()))
    np.savez_compressed(
        file,
        images=images.transpose(0, 3, 1, 2),
        extrinsic=world_to_camera[:, :3],
        intrinsic=intrinsics,
        depth=depth[..., None],
        depth_conf=sure,
    )


def _array(tensor: Any) -> npt.NDArray[np.float64]:
    values = tensor.detach().cpu().numpy() if hasattr(tensor, "detach") else tensor
    return np.asarray(values, np.float64)
