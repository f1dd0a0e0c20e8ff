"""A sample of nuScenes: a scan of five columns, two cameras, two boxes."""

import json

import numpy as np

from samples._parts import wall, write_noise

FORWARD = [[0, -1, 0, 0], [0, 0, -1, -0.3], [1, 0, 0, -0.4], [0, 0, 0, 1]]
BACK = [[0, 1, 0, 0], [0, 0, -1, -0.3], [-1, 0, 0, -0.4], [0, 0, 0, 1]]


def write(folder):
    x, y, z = wall().T
    np.stack([z, -x, -y, x * 0, x * 0], axis=1).astype("<f4").tofile(folder / "scan.pcd.bin")
    cameras = {}
    for seed, (name, pose) in enumerate({"CAM_FRONT": FORWARD, "CAM_BACK": BACK}.items()):
        write_noise(folder / f"{name}.png", seed)
        cameras[name] = {
            "img_path": f"{name}.png",
            "cam2img": [[20, 0, 7.5], [0, 20, 5.5], [0, 0, 1]],
            "lidar2cam": pose,
        }
    boxes = [[2.0, 0.2, 0.0, 1.0, 0.4, 0.6, 0.3], [-5.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.0]]
    sample = {
        "lidar": {"num_pts_feats": 5, "lidar_path": "scan.pcd.bin"},
        "cameras": cameras,
        "instances": [{"bbox_label": 0, "bbox_3d": box, "num_lidar_pts": 0} for box in boxes],
    }
    (folder / "sample.json").write_text(json.dumps(sample, indent=1))
    return folder
