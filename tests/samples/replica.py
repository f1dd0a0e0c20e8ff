"""Replica, as NICE-SLAM has it: two frames that look along y, and the mesh of the room."""

import json

import numpy as np
from PIL import Image

from samples._parts import HEIGHT, WIDTH, pose_along_y, wall_along_y, write_depth, write_ply


def write(folder):
    room = folder / "room0"
    lines = []
    for index in range(2):
        pixels = np.random.default_rng(index).integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
        (room / "results").mkdir(parents=True, exist_ok=True)
        Image.fromarray(pixels).save(room / "results" / f"frame{index:06d}.jpg", quality=95)
        write_depth(room / "results" / f"depth{index:06d}.png", 13107)  # 2 m
        pose = pose_along_y(index, flip=(1, 1, 1))
        lines.append(" ".join(f"{value:.18e}" for value in pose.flatten()))
    (room / "traj.txt").write_text("\n".join(lines) + "\n")
    camera = {"w": WIDTH, "h": HEIGHT, "fx": 14.0, "fy": 14.0, "cx": 7.5, "cy": 5.5, "scale": 6553.5}
    (folder / "cam_params.json").write_text(json.dumps({"camera": camera}))
    write_ply(folder / "room0_mesh.ply", wall_along_y())
    return room
