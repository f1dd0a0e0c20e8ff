"""Reads Replica as NICE-SLAM renders it (Straub et al. 2019; Zhu et al., CVPR 2022): one room.

results/frameNNNNNN.jpg      8-bit RGB
results/depthNNNNNN.png      16-bit, `scale` per metre, 0 = unknown
traj.txt                     a line for each frame (or the first ones): 16 numbers, camera-to-world by rows, OpenCV axes
../cam_params.json           {"camera": {"w", "h", "fx", "fy", "cx", "cy", "scale"}}; also in the room's folder
../ROOM_mesh.ply             the cloud: its vertices (optional: fused from depth if absent)
"""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor

from torchjoint.datasets.cameras import Camera, pinhole_matrix
from torchjoint.datasets.files.text import Record, parse_numbers, read_lines, read_record
from torchjoint.datasets.recording import Options, Shot, invert_pose, read_shots, scene_of_frames, tell_left_out
from torchjoint.runtime.foreign_files import has_file, has_folder
from torchjoint.scene import Scene
from torchjoint.scene.checks import as_pose

WHAT = "traj.txt and results/frame*.jpg, with cam_params.json here or above (Replica, as NICE-SLAM has it)"
CAMERA = "cam_params.json"


def recognizes(path: Path) -> bool:
    """Returns whether `path` is a room's folder."""
    return has_folder(path) and has_file(path / "traj.txt") and any((path / "results").glob("frame*.jpg"))


def load(path: Path, options: Options) -> Scene:
    """Loads the folder; see :func:`torchjoint.load_scene`."""
    file = next((one for one in (path / CAMERA, path.parent / CAMERA) if has_file(one)), path / CAMERA)
    values = read_record(file, "the camera of Replica").record("camera")
    scale = values.number("scale")
    if not scale > 0:
        raise ValueError(f"{values.name}: scale: expected steps per metre, > 0, got {scale:g}")
    camera, poses = _camera(values), _read_poses(path / "traj.txt")
    images = sorted((path / "results").glob("frame*.jpg"), key=lambda file: (len(file.stem), file.stem))
    if not 0 < len(poses) <= len(images):
        raise ValueError(f"{path / 'traj.txt'}: expected {len(images)} poses, one for each image, got {len(poses)}")
    tell_left_out(str(path), len(images) - len(poses), len(images))
    images = images[: len(poses)]
    depths = [image.with_name(f"{image.stem.replace('frame', 'depth')}.png") for image in images]
    shots = [
        Shot(image, camera, pose, image.stem, depth, 1 / scale)
        for image, pose, depth in zip(images, poses, depths, strict=True)
    ]
    return scene_of_frames(path, read_shots(shots), options, [path.parent / f"{path.name}_mesh.ply"])


def _camera(values: Record) -> Camera:
    fx, fy, cx, cy, width, height = (values.number(key) for key in ("fx", "fy", "cx", "cy", "w", "h"))
    return Camera(pinhole_matrix(fx, fy, cx, cy), (round(height), round(width)), name=values.name)


def _read_poses(file: Path) -> list[Tensor]:
    poses = []
    for name, line in read_lines(file, "lines of 16 numbers, camera-to-world poses"):
        numbers = parse_numbers(line.split(), name)
        if numbers:
            if len(numbers) != 16:
                raise ValueError(f"{name}: expected 16 numbers, a pose, got {len(numbers)}")
            pose = torch.tensor(numbers, dtype=torch.float64).reshape(4, 4)
            poses.append(invert_pose(as_pose(pose, name)))
    return poses
