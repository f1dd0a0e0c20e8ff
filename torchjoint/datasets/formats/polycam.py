"""Reads the raw data that Polycam (poly.cam) exports of a scan with LiDAR; its developer mode has the export.

keyframes/corrected_images/N.jpg    8-bit RGB, without distortion; N is a time
keyframes/corrected_cameras/N.json  width height fx fy cx cy, and t_00 ... t_23: camera-to-world, 3 x 4, by rows, OpenGL
                                    axes (y up, z back)
keyframes/images, cameras           the same before the optimization of poses; read where there are no corrected ones
keyframes/depth/N.png               16-bit, millimetres (optional)
keyframes/confidence/N.png          8-bit, 0 = low (optional); depth of low confidence is left out

The cloud is `cloud.ply`, or fused from depth: raw.glb is in other axes, and is not read. No scan was at hand. The
layout is that of Polycam's own reader, github.com/PolyCam/polyform (README.md, core/capture_folder.py).
"""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor

from torchjoint.datasets.cameras import FLIP_YZ, Camera, pinhole_matrix, resize_depth
from torchjoint.datasets.files.readers import read_depth, read_image, read_label_image
from torchjoint.datasets.files.text import Record, read_record
from torchjoint.datasets.recording import Options, invert_pose, scene_of_frames
from torchjoint.runtime.foreign_files import has_file, has_folder
from torchjoint.runtime.threads import LazySequence
from torchjoint.scene import Frame, Scene
from torchjoint.scene.checks import as_pose

WHAT = "keyframes/ with corrected_images/ and corrected_cameras/, or images/ and cameras/ (Polycam's raw data)"


def recognizes(path: Path) -> bool:
    """Returns whether `path` is an exported folder."""
    return has_folder(path) and any((path / "keyframes").glob("*cameras/*.json"))


def load(path: Path, options: Options) -> Scene:
    """Loads the folder; see :func:`torchjoint.load_scene`."""
    return scene_of_frames(path, _read_frames(path / "keyframes"), options)


def _read_frames(folder: Path) -> LazySequence[Frame]:
    # Corrected and other poses differ by a drift, so that a scene never has both.
    corrected = all(has_folder(folder / f"corrected_{kind}") for kind in ("images", "cameras"))
    kind = "corrected_" if corrected else ""
    images = sorted((folder / f"{kind}images").glob("*.jpg"), key=lambda file: (len(file.stem), file.stem))
    if not images:
        raise ValueError(f"{folder}/{kind}images: expected images, .jpg, got none")
    records = [read_record(folder / f"{kind}cameras" / f"{file.stem}.json", "a camera of Polycam") for file in images]
    poses = [_world_to_camera(record) for record in records]

    def read(index: int) -> Frame:
        file, camera = images[index], _camera(records[index])
        return camera.frame(read_image(file, camera.size), poses[index], _read_depth(folder, file.stem), file.stem)

    return LazySequence(len(images), read, [file.stem for file in images])


def _read_depth(folder: Path, stem: str) -> Tensor | None:
    file, confidence = folder / "depth" / f"{stem}.png", folder / "confidence" / f"{stem}.png"
    if not has_file(file):
        return None
    depth = read_depth(file)
    if not has_file(confidence):
        return depth
    sure = resize_depth(read_label_image(confidence), (depth.shape[0], depth.shape[1]), str(confidence)) > 0
    return torch.where(sure, depth, 0.0)


def _world_to_camera(values: Record) -> Tensor:
    pose = torch.eye(4, dtype=torch.float64)
    for row in range(3):
        for column in range(4):
            pose[row, column] = values.number(f"t_{row}{column}")
    return invert_pose(as_pose(pose, values.name) @ FLIP_YZ)


def _camera(values: Record) -> Camera:
    fx, fy, cx, cy, width, height = (values.number(key) for key in ("fx", "fy", "cx", "cy", "width", "height"))
    return Camera(pinhole_matrix(fx, fy, cx, cy), (round(height), round(width)), name=values.name)
