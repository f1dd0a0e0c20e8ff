"""KITTI object: one scan and one image, a box and a region to ignore."""

import numpy as np

from samples._parts import wall, write_noise

CALIBRATION = """P0: 20 0 7.5 0 0 20 5.5 0 0 0 1 0
P2: 20 0 7.5 1.2 0 20 5.5 0.02 0 0 1 0.003
R0_rect: 1 0 0 0 1 0 0 0 1
Tr_velo_to_cam: 0 -1 0 0 0 0 -1 -0.08 1 0 0 -0.27
"""
LABELS = """Car 0.00 0 -1.5 2.0 3.0 9.0 8.0 0.6 0.8 1.0 0.1 0.3 1.8 0.4
DontCare -1 -1 -10 5.0 1.0 5.9 1.9 -1 -1 -1 -1000 -1000 -1000 -10
"""


def write(folder):
    root = folder / "training"
    for name in ("velodyne", "calib", "label_2"):
        (root / name).mkdir(parents=True)
    x, y, z = wall().T
    np.stack([z, -x, -y, np.full(len(x), 0.5)], axis=1).astype("<f4").tofile(root / "velodyne" / "000007.bin")
    write_noise(root / "image_2" / "000007.png", 0)
    (root / "calib" / "000007.txt").write_text(CALIBRATION)
    (root / "label_2" / "000007.txt").write_text(LABELS)
    return root / "velodyne" / "000007.bin"
