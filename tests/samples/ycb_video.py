"""YCB-Video: two frames of a sequence with labels, and a cloud."""

import numpy as np
from PIL import Image
from scipy.io import savemat

from samples._parts import HEIGHT, WIDTH, wall, write_depth, write_noise, write_ply


def write(folder):
    scene = folder / "0048"
    scene.mkdir()
    for index in range(1, 3):
        stem = f"{index:06d}"
        write_noise(scene / f"{stem}-color.{'png' if index == 1 else 'jpg'}", index)
        write_depth(scene / f"{stem}-depth.png", 20000)
        labels = np.zeros((HEIGHT, WIDTH), np.uint8)
        labels[:4], labels[8:] = 3, 21
        Image.fromarray(labels).save(scene / f"{stem}-label.png")
        pose = np.eye(4)[:3]
        pose[0, 3] = 0.1 * index
        meta = {
            "cls_indexes": np.array([[3], [21]], dtype=np.uint8),
            "intrinsic_matrix": np.array([[20.0, 0, 7.5], [0, 20, 5.5], [0, 0, 1]]),
            "factor_depth": np.array([[10000]], dtype=np.uint16),
            "poses": np.zeros((3, 4, 2)),
            "rotation_translation_matrix": pose,
        }
        savemat(scene / f"{stem}-meta.mat", meta, do_compression=index == 2)
    write_ply(scene / "cloud.ply", wall())
    return scene
