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

import warnings
from functools import partial
from pathlib import Path

import torch
from torch import Tensor

from torchjoint.datasets.cameras import pinhole, resize_depth, world_to_camera
from torchjoint.datasets.files.readers import labels_of, read_depth, read_raster
from torchjoint.datasets.files.text import Record, read_record
from torchjoint.datasets.recording import Options, Shot, read_shots, scene_of_frames, sorted_images, tell_lost
from torchjoint.runtime.foreign_files import has_file, has_folder
from torchjoint.scene import Scene

WHAT = "keyframes/ with corrected_images/ and corrected_cameras/, or images/ and cameras/ (Polycam's raw data)"


def recognizes(path: Path) -> bool:
    return has_folder(path) and any((path / "keyframes").glob("*cameras/*.json"))


def load(path: Path, options: Options) -> Scene:
    folder = path / "keyframes"
    # Corrected and other poses differ by a drift, so that a scene never has both.
    corrected = [one for kind in ("images", "cameras") if has_folder(one := folder / f"corrected_{kind}")]
    if len(corrected) == 1:
        warnings.warn(f"{corrected[0]}: not read without its other half; the poses of cameras/ drift", stacklevel=3)
    images, cameras = corrected if len(corrected) == 2 else (folder / "images", folder / "cameras")
    files = sorted_images(images, images.glob("*.jpg"))
    if not files:
        raise ValueError(f"{images}: expected images, .jpg, got none")
    tell_lost(str(path), (file.stem for file in cameras.glob("[!.]*.json")), [file.stem for file in files])
    shots = [_shot(file, read_record(cameras / f"{file.stem}.json", "a camera of Polycam"), folder) for file in files]
    return scene_of_frames(path, read_shots(shots), options)


def _shot(file: Path, values: Record, folder: Path) -> Shot:
    pose = [[values.number(f"t_{row}{column}") for column in range(4)] for row in range(3)]
    camera = pinhole((values.number(key) for key in ("fx", "fy", "cx", "cy", "width", "height")), values.name)
    extrinsics = world_to_camera(torch.tensor(pose, dtype=torch.float64), values.name, opengl=True)
    depth = partial(_read_depth, folder, file.stem) if has_file(folder / "depth" / f"{file.stem}.png") else None
    return Shot(file, camera, extrinsics, file.stem, depth)


def _read_depth(folder: Path, stem: str) -> Tensor:
    depth, confidence = read_depth(folder / "depth" / f"{stem}.png"), folder / "confidence" / f"{stem}.png"
    if not has_file(confidence):
        return depth
    sure = labels_of(read_raster(confidence), str(confidence))
    return torch.where(resize_depth(sure, (depth.shape[0], depth.shape[1]), str(confidence)) > 0, depth, 0.0)
