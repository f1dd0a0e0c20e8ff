"""nerfstudio: two distorted images of cameras of their own, depth in two formats, a sparse cloud."""

import json

import numpy as np

from samples._parts import HEIGHT, WIDTH, wall, write_depth, write_noise, write_ply


def write(folder):
    frames = []
    for index in range(2):
        write_noise(folder / "images" / f"frame_{index:05d}.png", index)
        pose = np.diag([1.0, -1.0, -1.0, 1.0])  # OpenGL's axes
        pose[0, 3] = 0.1 * index
        frame = {"file_path": f"images/frame_{index:05d}.png", "transform_matrix": pose.tolist(), "fl_x": 20.0 + index}
        frame["depth_file_path"] = "depths/0.png" if index else "depths/0.npy"
        frames.append(frame)
    write_depth(folder / "depths" / "0.png", 2000)
    np.save(folder / "depths" / "0.npy", np.full((HEIGHT // 2, WIDTH // 2), 2.0, dtype=np.float32))
    write_ply(folder / "sparse_pc.ply", wall())
    values = {
        "camera_model": "OPENCV",
        "w": WIDTH, "h": HEIGHT, "fl_y": 20.0, "cx": 8.0, "cy": 6.0, "k1": 0.1, "k2": -0.01, "p1": 0.001, "p2": 0.0,
        "frames": frames,
        "applied_transform": [[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, -1.0, 0.0, 0.0]],
        "ply_file_path": "sparse_pc.ply",
    }  # fmt: skip
    (folder / "transforms.json").write_text(json.dumps(values, indent=1))
    return folder
