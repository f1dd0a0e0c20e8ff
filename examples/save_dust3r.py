"""Saves what DUSt3R and MASt3R make of images as torchjoint reads it: it segments the points and the images together.

Beside their program, behind the global alignment:

    from save_dust3r import save
    save(scene, "room")                           # what global_aligner or sparse_global_alignment returned

and then `torchjoint segment room`, or `tj.load_scene("room")`. The images must have one size. Written against the code
of both in 2025, and tried with objects that answer as theirs do; the networks themselves were not run, because their
licence is for research only.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt


def save(scene: Any, folder: str | Path) -> None:
    """Writes cameras and depth of an aligned scene in the layout of VGGT's demo, which `tj.load_scene` reads.

    Args:
        scene: has `imgs`, `get_focals`, `get_principal_points` and `get_im_poses`; and `get_dense_pts3d` (MASt3R), or
            `get_depthmaps` and `im_conf` (DUSt3R).
        folder: gets predictions.npz.

    Raises:
        ValueError: the images have different sizes.
    """
    pictures = [np.asarray(image, np.float32) for image in scene.imgs]  # [H, W, 3] RGB in [0, 1]
    if len({picture.shape for picture in pictures}) != 1:
        raise ValueError(f"scene: expected images of one size, got {sorted({one.shape for one in pictures})}")
    images = np.stack(pictures)
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
    Path(folder).mkdir(parents=True, exist_ok=True)
    np.savez_compressed(
        Path(folder) / "predictions.npz",
        images=images.transpose(0, 3, 1, 2),
        extrinsic=world_to_camera[:, :3].astype(np.float32),
        intrinsic=intrinsics.astype(np.float32),
        depth=depth[..., None].astype(np.float32),
        depth_conf=sure.astype(np.float32),
    )


def _array(tensor: Any) -> npt.NDArray[np.float64]:
    values = tensor.detach().cpu().numpy() if hasattr(tensor, "detach") else tensor
    return np.asarray(values, np.float64)
