"""A LiDAR's cloud as text and an image, with a guess of how they go together."""

import json

import numpy as np
from pcd_files import write_pcd

from samples._parts import wall, write_noise


def write(folder):
    x, y, z = wall().astype(np.float32).T
    intensity = np.full_like(x, 16)
    write_pcd(folder / "pointcloud.pcd", {"x": z, "y": -x, "z": -y, "intensity": intensity}, data="ascii")
    write_noise(folder / "image.png", 0)
    camera = {"K": [20.0, 0.0, 7.5, 0.0, 20.0, 5.5, 0.0, 0.0, 1.0]}
    (folder / "camera_info.json").write_text(json.dumps(camera))
    guess = {"x": 0.0, "y": 0.1, "z": 0.0, "r_deg": 90.0, "p_deg": 0.0, "y_deg": 90.0}
    (folder / "initial_guess.json").write_text(json.dumps(guess))
    return folder
