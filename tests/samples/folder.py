"""A plain folder in the style of 7-Scenes: two frames of a slanted wall, depth, truth, and a cloud."""

import numpy as np
from PIL import Image

HEIGHT, WIDTH = 12, 16


def write(folder):
    rng = np.random.default_rng(0)
    np.savetxt(folder / "camera-intrinsics.txt", [[20, 0, 7.5], [0, 20, 5.5], [0, 0, 1]])
    for index in range(2):
        stem = folder / f"frame-{index:06d}"
        pose = np.eye(4)
        pose[0, 3] = 0.1 * index
        np.savetxt(f"{stem}.pose.txt", pose)
        pixels = rng.integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
        Image.fromarray(pixels).save(f"{stem}.color.png" if index else f"{stem}.color.jpg")
        Image.fromarray(np.full((HEIGHT, WIDTH), 2000, dtype=np.uint16)).save(f"{stem}.depth.png")
        Image.fromarray(np.repeat([[1], [2]], HEIGHT // 2, axis=0).repeat(WIDTH, axis=1).astype(np.uint8)).save(
            f"{stem}.truth.png"
        )
    points = rng.uniform([-0.5, -0.5, 1.9], [0.5, 0.5, 2.1], (40, 3))
    lines = [" ".join(f"{value:.4f}" for value in point) for point in points]
    header = ["ply", "format ascii 1.0", f"element vertex {len(points)}"]
    header += [f"property float {axis}" for axis in "xyz"] + ["end_header"]
    (folder / "cloud.ply").write_text("\n".join(header + lines) + "\n")
    np.save(folder / "cloud.truth.npy", (points[:, 1] > 0).astype(np.int32))
    return folder
