"""A scan of ScanNet whose frames were exported, with both calibrations, and zipped instances of pixels."""

import zipfile

import numpy as np
from PIL import Image
from scannet_files import (
    lost,
    random_shots,
    write_exported,
    write_info,
    write_intrinsics,
    write_mesh,
    write_point_truth,
)

FORMAT = "scannet"
CAMERA = [[16, 0, 7.5], [0, 16, 5.5], [0, 0, 1]]
SCAN = "scene0001_00"


def write(folder):
    rng = np.random.default_rng(0)
    scan = folder / SCAN
    shots = list(random_shots(rng, 2, (12, 16), (12, 16)))
    write_exported(scan, [*shots, lost(shots[0])])
    write_intrinsics(scan, CAMERA, CAMERA)
    write_info(scan / f"{SCAN}.txt", CAMERA, CAMERA, (12, 16), (12, 16))
    points = rng.uniform([-0.4, -0.3, 1.9], [0.4, 0.3, 2.1], (20, 3))
    write_mesh(scan / f"{SCAN}_vh_clean_2.ply", points, rng.integers(0, 256, (20, 3)))
    write_point_truth(scan, SCAN, np.arange(20) // 7)
    with zipfile.ZipFile(scan / f"{SCAN}_2d-instance-filt.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        for index in range(3):
            Image.new("L", (16, 12), index).save(folder / "label.png")
            archive.write(folder / "label.png", f"instance-filt/{index}.png")
    (folder / "label.png").unlink()
    return scan
