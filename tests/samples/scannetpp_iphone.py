"""ScanNet++: two frames of the iPhone's video and a third pose, with depth and the poses of ARKit."""

import json

from samples._parts import pose_along_y, write_depth, write_noise
from samples.scannetpp import write_scan

FORMAT = "scannetpp"


def write(folder):
    scene, values = folder / "data" / "1ada7a0617", {}
    write_scan(scene)
    for index in range(3):
        pose = pose_along_y(index, flip=(1, 1, 1)).tolist()
        # Of the images of 1920 x 1440; those of this sample are 120 times smaller.
        camera = [[1680.0, 0.0, 959.5], [0.0, 1680.0, 719.5], [0.0, 0.0, 1.0]]
        values[f"frame_{index:06d}"] = {"timestamp": index / 60, "aligned_pose": pose, "intrinsic": camera}
        if index < 2:
            write_noise(scene / "iphone" / "rgb" / f"frame_{index:06d}.jpg", index)
            write_depth(scene / "iphone" / "depth" / f"frame_{index:06d}.png", 2000)
    (scene / "iphone" / "pose_intrinsic_imu.json").write_text(json.dumps(values))
    return scene
