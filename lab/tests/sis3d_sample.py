"""A scene of 3D-SIS' examples: two resized frames, a mesh, a volume with two objects, and the way to its voxels."""

import numpy as np
from scannet_files import random_shots, write_exported, write_mesh
from sis3d_files import boxes_of, world_to_grid, write_volume

SCAN = "scene0144_00"


def write(folder):
    rng = np.random.default_rng(0)
    frames, mesh, volumes = folder / "images_square" / SCAN, folder / "scans" / SCAN, folder / "scenes"
    shots = list(random_shots(rng, 2, (12, 16), (12, 16)))
    write_exported(frames, shots, step=20)
    points = rng.uniform([-0.4, -0.3, 1.9], [0.4, 0.3, 2.1], (40, 3)).astype(np.float32)
    np.savetxt(frames / "world2grid.txt", world_to_grid(points), fmt="%f")
    mesh.mkdir(parents=True)
    write_mesh(mesh / f"{SCAN}_vh_clean_2.ply", points, rng.integers(0, 256, (40, 3)))
    labels = np.where(points[:, 0] > 0.1, 1, np.where(points[:, 0] < -0.1, 0, -1))
    boxes, masks = boxes_of(points, labels, [0, 1])
    volumes.mkdir()
    write_volume(volumes / f"{SCAN}__0__.scene", (6, 7, 8), boxes, [5, 7], masks, np.eye(4), [0, 20])
    return frames
