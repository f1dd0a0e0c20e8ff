"""Reads Replica as NICE-SLAM renders it (Straub et al. 2019; Zhu et al., CVPR 2022): one room.

results/frameNNNNNN.jpg      8-bit RGB
results/depthNNNNNN.png      16-bit, `scale` per metre, 0 = unknown
traj.txt                     a line for each frame (or the first ones): 16 numbers, camera-to-world by rows, OpenCV axes
../cam_params.json           {"camera": {"w", "h", "fx", "fy", "cx", "cy", "scale"}}; also in the room's folder
../ROOM_mesh.ply             the cloud: its vertices (optional: fused from depth if absent)
"""

import warnings
from itertools import pairwise
from pathlib import Path

import torch

from torchjoint.datasets.cameras import pinhole, world_to_camera
from torchjoint.datasets.files.text import read_record, read_rows
from torchjoint.datasets.recording import Options, Shot, read_shots, scene_of_frames, sorted_images, tell_left_out
from torchjoint.runtime.foreign_files import has_file, has_folder
from torchjoint.scene import Scene

WHAT = "traj.txt and results/frame*.jpg, with cam_params.json here or above (Replica, as NICE-SLAM has it)"
CAMERA = "cam_params.json"


def recognizes(path: Path) -> bool:
    return has_folder(path) and has_file(path / "traj.txt") and any((path / "results").glob("frame*.jpg"))


def load(path: Path, options: Options) -> Scene:
    file = next((one for one in (path / CAMERA, path.parent / CAMERA) if has_file(one)), path / CAMERA)
    values = read_record(file, "the camera of Replica").record("camera")
    scale = values.number("scale")
    if not 1 <= scale <= 1e6:
        raise ValueError(f"{values.name}: scale: expected steps per metre, 1 to 1e6, got {scale:g}")
    camera = pinhole((values.number(key) for key in ("fx", "fy", "cx", "cy", "w", "h")), values.name)
    rows = read_rows(path / "traj.txt", "16 numbers, a pose", 16)
    poses = [world_to_camera(torch.tensor(numbers, dtype=torch.float64).view(4, 4), name) for name, numbers in rows]
    folder = path / "results"
    images = sorted_images(folder, (one for one in folder.glob("frame*.jpg") if one.stem[5:].isdecimal()))
    if not 0 < len(poses) <= len(images):
        raise ValueError(f"{path / 'traj.txt'}: expected {len(images)} poses, one for each image, got {len(poses)}")
    numbers = [int(image.stem[5:]) for image in images]
    if len(poses) < len(images):  # the first ones: those of the first numbers
        if lost := {*range(numbers[0], numbers[0] + len(poses))}.difference(numbers):
            told = f"frame {min(lost)} has no image, and {len(images) - len(poses)} images have no pose"
            raise ValueError(f"{path / 'traj.txt'}: {told}: expected a pose for each image")
    elif len({second - first for first, second in pairwise(numbers)}) > 1:
        warnings.warn(f"{path}: numbers of images are missing; poses are taken in their order", stacklevel=3)
    tell_left_out(str(path), len(images) - len(poses), len(images))
    shots = [
        Shot(image, camera, pose, image.stem, image.with_name(f"{image.stem.replace('frame', 'depth')}.png"), 1 / scale)
        for image, pose in zip(images, poses, strict=False)
    ]
    return scene_of_frames(path, read_shots(shots), options, [path.parent / f"{path.name}_mesh.ply"])
