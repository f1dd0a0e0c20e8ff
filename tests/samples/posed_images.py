"""Frames as MMDetection3D exports them, and the mesh with its annotation in scans/ beside."""

import numpy as np
from PIL import Image
from scannet_files import four, lost, random_shots, write_mesh, write_point_truth

SCAN = "scene0001_00"


def write(folder):
    rng = np.random.default_rng(0)
    images, scan = folder / "posed_images" / SCAN, folder / "scans" / SCAN
    images.mkdir(parents=True)
    scan.mkdir(parents=True)
    shots = list(random_shots(rng, 2, (12, 16), (6, 8)))
    for index, shot in enumerate([*shots, lost(shots[0])]):
        Image.fromarray(shot.color).save(images / f"{index:05d}.jpg")
        Image.fromarray(shot.depth).save(images / f"{index:05d}.png")
        np.savetxt(images / f"{index:05d}.txt", shot.pose)
    np.savetxt(images / "intrinsic.txt", four([[16, 0, 7.5], [0, 16, 5.5], [0, 0, 1]]))
    np.savetxt(images / "depth_intrinsic.txt", four([[8, 0, 3.5], [0, 8, 2.5], [0, 0, 1]]))
    points = rng.uniform([-0.4, -0.3, 1.9], [0.4, 0.3, 2.1], (20, 3))
    write_mesh(scan / f"{SCAN}_vh_clean_2.ply", points, rng.integers(0, 256, (20, 3)))
    write_point_truth(scan, SCAN, np.arange(20) // 7)
    return images
