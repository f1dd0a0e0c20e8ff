"""A plain folder in the style of 7-Scenes: two frames of a slanted wall, depth, truth, and a cloud."""

import numpy as np
from PIL import Image

from samples._parts import HEIGHT, WIDTH, wall, write_depth, write_noise, write_ply


def write(folder):
    np.savetxt(folder / "camera-intrinsics.txt", [[20, 0, 7.5], [0, 20, 5.5], [0, 0, 1]])
    for index in range(2):
        stem = f"frame-{index:06d}"
        pose = np.eye(4)
        pose[0, 3] = 0.1 * index
        np.savetxt(folder / f"{stem}.pose.txt", pose)
        write_noise(folder / f"{stem}.color.{'png' if index else 'jpg'}", index)
        write_depth(folder / f"{stem}.depth.png", 2000)
        halves = np.repeat([[1], [2]], HEIGHT // 2, axis=0).repeat(WIDTH, axis=1).astype(np.uint8)
        Image.fromarray(halves).save(folder / f"{stem}.truth.png")
    points = wall()
    write_ply(folder / "cloud.ply", points)
    np.save(folder / "cloud.truth.npy", (points[:, 1] > 0).astype(np.int32))
    return folder
