"""A recording in a plain folder, and its truth, written with nothing of the reader's code."""

import numpy as np
from PIL import Image

from torchjoint.datasets.files.ply import write_cloud


def write_folder(folder, synthetic, *, cloud=True, depth=True):
    """Writes a plain folder of the frames, with or without depth and the cloud. Returns it."""
    folder.mkdir()
    frames = synthetic.scene.frames
    np.savetxt(folder / "camera-intrinsics.txt", frames[0].intrinsics.numpy())
    for index, frame in enumerate(frames):
        stem = f"frame-{index * 5:06d}"
        pixels = (frame.image * 255).round().byte().permute(1, 2, 0).numpy()
        Image.fromarray(pixels).save(folder / f"{stem}.color.png")
        np.savetxt(folder / f"{stem}.pose.txt", np.linalg.inv(frame.world_to_camera.numpy()))
        if depth:
            millimetres = (frame.depth * 1000).round().numpy().astype(np.uint16)
            millimetres[0, 0] = 65535
            Image.fromarray(millimetres).save(folder / f"{stem}.depth.png")
    if cloud:
        write_cloud(folder / "cloud.ply", synthetic.scene.points, synthetic.scene.colors)
    return folder


def write_truth(folder, synthetic):
    """Writes the true labels of points and images beside what `write_folder` wrote."""
    np.save(folder / "cloud.truth.npy", synthetic.point_labels.numpy())
    for index, labels in enumerate(synthetic.image_labels):
        Image.fromarray((labels.numpy() + 1).astype(np.uint16)).save(folder / f"frame-{index * 5:06d}.truth.png")


def write_scans(folder, scene):
    """Writes three recordings of one scene, a, b and c, without depth, and returns their folder."""
    folder.mkdir()
    for name in ("a", "b", "c"):
        write_folder(folder / name, scene, depth=False)
    return folder
