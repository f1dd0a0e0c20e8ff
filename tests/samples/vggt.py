"""VGGT's predictions: two frames that look along y at a wall; the unit of length is 4 m."""

import numpy as np

from samples._parts import HEIGHT, WIDTH, pose_along_y

UNIT = 4.0


def write(folder):
    world_to_camera = [np.linalg.inv(pose_along_y(index, flip=(1, 1, 1)))[:3] for index in range(2)]
    extrinsic = np.array(world_to_camera, np.float32)
    extrinsic[:, :, 3] /= UNIT
    random = np.random.default_rng(0)
    sure = np.ones((2, HEIGHT, WIDTH), np.float32)
    sure[:, :3] = 0.5  # a quarter of the rows, whose depth is wrong
    depth = np.full((2, HEIGHT, WIDTH, 1), 2 / UNIT, np.float32)
    depth[:, :3] = 7
    np.savez(
        folder / "predictions.npz",
        pose_enc=np.zeros((2, 9), np.float32),
        images=random.random((2, 3, HEIGHT, WIDTH), dtype=np.float32),
        extrinsic=extrinsic,
        intrinsic=np.array([[[14, 0, 7.5], [0, 14, 5.5], [0, 0, 1]]] * 2, np.float32),
        depth=depth,
        depth_conf=sure,
    )
    return folder
