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
