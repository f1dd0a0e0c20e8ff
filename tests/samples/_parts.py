"""Parts that several samples have."""

import numpy as np
from PIL import Image

HEIGHT, WIDTH = 12, 16


def write_noise(path, seed):
    """A colour image, 8 bits."""
    pixels = np.random.default_rng(seed).integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(pixels).save(path)


def write_depth(path, raw):
    """A depth image of one depth, 16 bits."""
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.full((HEIGHT, WIDTH), raw, dtype=np.uint16)).save(path)


def wall(seed=0):
    """40 points of a wall 2 m before a camera at the origin."""
    return np.random.default_rng(seed).uniform([-0.5, -0.5, 1.9], [0.5, 0.5, 2.1], (40, 3))


def write_ply(path, points):
    """A cloud, as text."""
    lines = [" ".join(f"{value:.4f}" for value in point) for point in points]
    header = ["ply", "format ascii 1.0", f"element vertex {len(points)}"]
    header += [f"property float {axis}" for axis in "xyz"] + ["end_header"]
    path.write_text("\n".join(header + lines) + "\n")


#: World-to-camera of a camera that looks along y: x stays, z of the world is -y of the camera. OpenCV's axes.
ALONG_Y = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


def pose_along_y(index, flip=(1, -1, -1)):
    """Camera-to-world of a camera at x = index / 10; OpenGL's axes, or with flip=(1, 1, 1) OpenCV's."""
    pose = np.eye(4)
    pose[:3, :3] = ALONG_Y.T * flip
    pose[0, 3] = 0.1 * index
    return pose


def wall_along_y():
    """The wall before that camera."""
    return wall()[:, [0, 2, 1]] * [1, 1, -1]
