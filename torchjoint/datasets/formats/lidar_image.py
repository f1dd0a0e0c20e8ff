"""Reads a LiDAR cloud and one image, with a calibration or an initial guess of the calibration.

pointcloud.pcd       metres; points without a return (NaN, or 0 0 0) are left out
image.png            (or .jpg)
camera_info.json     {"K": [9 numbers], row-major; optional "D": OpenCV's lens distortion, "distortion_model" and
                     the "width" and "height" of K}: the image is undistorted
extrinsic.txt        4x4, world-to-camera (LiDAR to camera, OpenCV axes)
initial_guess.json   instead of extrinsic.txt: {"x", "y", "z", "r_deg", "p_deg", "y_deg"}, also LiDAR to camera: first
                     the rotation Rx(r) Ry(p) Rz(y), then the translation, metres. 90, 0, 90 degrees turn a LiDAR's
                     axes (x forward, y left, z up) into the axes of a camera with the same view direction (z forward,
                     x right, y down)

The world frame is the LiDAR's frame. A guess may be wrong: the pose is checked before segmenting (PoseWarning).
"""

from pathlib import Path

import torch
from torch import Tensor

from torchjoint.datasets.cameras import Camera, checked_pose, rotations_about
from torchjoint.datasets.files.columns import repaired
from torchjoint.datasets.files.pcd import read_pcd
from torchjoint.datasets.files.readers import read_matrix
from torchjoint.datasets.files.text import Record, read_record
from torchjoint.datasets.recording import Options, Shot, read_shots
from torchjoint.runtime.foreign_files import has_file, has_folder, present
from torchjoint.scene import Scene
from torchjoint.scene.checks import as_pose, kept_points

WHAT = "pointcloud.pcd, image.png (or .jpg), camera_info.json and extrinsic.txt or initial_guess.json"


_LENSES = ("plumb_bob", "rational_polynomial", "equidistant")


def recognizes(path: Path) -> bool:
    return has_folder(path) and all(has_file(path / name) for name in ("pointcloud.pcd", "camera_info.json"))


def load(path: Path, options: Options) -> Scene:
    file = path / "pointcloud.pcd"
    cloud = read_pcd(file).cloud(str(file))
    cloud = cloud.chosen(cloud.points.isfinite().all(1))
    cloud = repaired(cloud.chosen(kept_points(cloud.points, str(file), "keep", "drop any")), str(file))
    camera, pose = _read_camera(path / "camera_info.json"), _read_pose(path)
    images = path / "image.png", path / "image.jpg"
    image = present(next(filter(has_file, images), images[0]), "image.png or image.jpg beside pointcloud.pcd")
    frames = read_shots([Shot(image, camera, pose, "image")])
    return Scene(cloud.points, frames, cloud.colors, cloud.normals, name=path.name)


def _read_camera(path: Path) -> Camera:
    record = read_record(path, "a camera's K")
    distortion = record.values["D"] if "D" in record else []
    count = len(distortion) if isinstance(distortion, list) else type(distortion).__name__
    if count not in (0, 4, 5, 8):
        raise ValueError(f"{path}: D: expected 4, 5 or 8 numbers as of OpenCV, got {count}")
    lens = tuple(record.numbers("D", len(distortion)).tolist()) if distortion else ()
    model = record.text("distortion_model", "") or "plumb_bob"
    if model not in _LENSES:
        raise ValueError(f"{path}: distortion_model: expected one of {', '.join(_LENSES)}, got {model!r}")
    size = round(record.number("height", 0)), round(record.number("width", 0))
    roi = record.record("roi") if "roi" in record else Record({}, str(path))
    part = [roi.number(key, 0) for key in ("x_offset", "y_offset", "height", "width")]
    if any(part) and part != [0, 0, *size]:
        raise ValueError(f"{path}: roi: expected none, got {roi.values}; give the K, width and height of the part")
    K = record.numbers("K", 9).view(3, 3)
    return Camera(K, size if any(size) else None, lens, str(path), fisheye=model == "equidistant")


def _read_pose(path: Path) -> Tensor:
    file = path / "extrinsic.txt"
    if has_file(file):
        return as_pose(read_matrix(file, (4, 4)), str(file))
    file = present(path / "initial_guess.json", "extrinsic.txt or initial_guess.json beside pointcloud.pcd")
    guess = read_record(file, "a guess of the pose")
    numbers = [guess.number(key) for key in ("x", "y", "z", "r_deg", "p_deg", "y_deg")]
    position, degrees = torch.tensor(numbers, dtype=torch.float64).view(2, 3)
    roll, pitch, yaw = (rotations_about(axis, degrees[axis : axis + 1].deg2rad())[0] for axis in range(3))
    return checked_pose(torch.cat([roll @ pitch @ yaw, position[:, None]], 1), str(file))
