"""A scan of ScanNet: a sensor stream of three frames, one of them lost, a mesh, its instances, and those of pixels."""

import numpy as np
from scannet_files import lost, random_shots, write_image_truth, write_mesh, write_point_truth, write_sens

COLOR = [[24, 0, 11.5], [0, 24, 8.5], [0, 0, 1]]
DEPTH = [[12, 0, 5.5], [0, 12, 4.1], [0, 0, 1]]


def write(folder):
    rng = np.random.default_rng(0)
    scan = folder / "scene0000_00"
    scan.mkdir()
    shots = list(random_shots(rng, 3, (18, 24), (9, 12)))
    shots[1] = lost(shots[1])
    write_sens(scan / "scene0000_00.sens", shots, COLOR, DEPTH)
    points = rng.uniform([-0.5, -0.5, 1.9], [0.5, 0.5, 2.1], (40, 3))
    write_mesh(scan / "scene0000_00_vh_clean_2.ply", points, rng.integers(0, 256, (40, 3)))
    write_point_truth(scan, "scene0000_00", np.arange(40) // 10 - 1)
    write_image_truth(scan, [np.arange(18)[:, None] // 6 + np.zeros((1, 24), dtype=int) - 1] * 3)
    return scan
