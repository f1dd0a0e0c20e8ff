"""A LiDAR's cloud in binary and an image of a lens with distortion, with an extrinsic calibration."""

import json

import numpy as np
from pcd_files import write_pcd

from samples._parts import wall, write_noise

FORMAT = "lidar_image"


def write(folder):
    x, y, z = wall().astype(np.float32).T
    rgb = np.arange(len(x), dtype=np.uint32).view(np.float32)
    fields = {"x": z, "y": -x, "z": -y, "rgb": rgb, "ring": np.zeros(len(x), dtype=np.uint16)}
    write_pcd(folder / "pointcloud.pcd", fields, data="binary")
    write_noise(folder / "image.png", 0)
    camera = {"K": [20.0, 0.0, 7.5, 0.0, 20.0, 5.5, 0.0, 0.0, 1.0], "D": [0.1, -0.01, 0.001, 0.0, 0.0]}
    (folder / "camera_info.json").write_text(json.dumps(camera))
    np.savetxt(folder / "extrinsic.txt", [[0, -1, 0, 0.1], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
    return folder
