"""Reads KITTI object detection (A. Geiger, P. Lenz, R. Urtasun, CVPR 2012): one LiDAR scan and one image per scene.

training/velodyne/NNNNNN.bin   float32 x, y, z, reflectance
training/image_2/NNNNNN.png    8-bit, rectified
training/calib/NNNNNN.txt      P2 3x4, R0_rect 3x3, Tr_velo_to_cam 3x4: pixel ~ P2 R0_rect Tr_velo_to_cam point
training/label_2/NNNNNN.txt    boxes (optional), in the rectified frame of camera 0: bottom centre, yaw about y

The world frame is the LiDAR's frame. All points are kept, also points out of the camera's view, and returns from the
car itself. The first three columns of P2 are the intrinsics; the fourth column, the position of camera 2 relative to
camera 0, goes into the pose. Rounding in the file makes the rotations inexact; the nearest rotations are used.

Ground truth: a point in a box gets the box's index in the file ("DontCare" boxes do not count), and where boxes overlap
the smallest box; all other points are void. The image has no ground truth.
"""

from pathlib import Path

import torch
from torch import Tensor

from torchjoint.datasets.cameras import Camera, rotations_about
from torchjoint.datasets.files.clouds import read_scan
from torchjoint.datasets.files.text import parse_numbers, read_lines
from torchjoint.datasets.recording import Options, Shot, read_shots
from torchjoint.datasets.truth import instances_in_boxes
from torchjoint.runtime.foreign_files import dict_of, has_file, has_folder, present
from torchjoint.scene import Scene, Truth
from torchjoint.scene.checks import as_intrinsics, as_pose

WHAT = "KITTI object: velodyne/NNNNNN.bin (or image_2/NNNNNN.png) with calib/ beside its folder"


def recognizes(path: Path) -> bool:
    folder = path.absolute().parent
    kinds = {("velodyne", ".bin"), ("image_2", ".png")}
    return (folder.name, path.suffix.lower()) in kinds and has_file(path) and _is_root(folder.parent)


def scenes(path: Path) -> dict[str, Path]:
    """Returns the LiDAR scans of training/, of testing/, or of the folder that holds training/."""
    root = path if _is_root(path) else path / "training"
    return {file.stem: file for file in sorted((root / "velodyne").glob("[!.]*.bin"))} if _is_root(root) else {}


def load(path: Path, options: Options) -> Scene:
    root, name = path.absolute().parent.parent, path.stem
    points = read_scan(root / "velodyne" / f"{name}.bin", 4, options.invalid, plausible=True)[:, :3]
    calibration = _read_calibration(root / "calib" / f"{name}.txt")
    projection = calibration["P2"]
    rectified_from_world = calibration["R0_rect"] @ calibration["Tr_velo_to_cam"]
    camera_from_rectified = torch.eye(4, dtype=torch.float64)
    camera_from_rectified[:3, 3] = torch.linalg.solve(projection[:3, :3], projection[:3, 3])
    world_to_camera = camera_from_rectified @ rectified_from_world
    image = present(root / "image_2" / f"{name}.png", "the image of the scan")
    frames = read_shots([Shot(image, Camera(projection[:3, :3]), world_to_camera, name)])
    labels = root / "label_2" / f"{name}.txt"
    truth = Truth(_instances(labels, points, rectified_from_world)) if has_file(labels) else None
    return Scene(points, frames, name=name, truth=truth)


def _is_root(path: Path) -> bool:
    return all(has_folder(path / name) for name in ("velodyne", "image_2", "calib"))


def _read_calibration(path: Path) -> dict[str, Tensor]:
    """P2, R0_rect and Tr_velo_to_cam, each as [4, 4]; R0_rect and Tr_velo_to_cam are rigid."""
    columns, found = {"P2": 4, "R0_rect": 3, "Tr_velo_to_cam": 4}, []
    for name, line in read_lines(path, "lines P2, R0_rect and Tr_velo_to_cam"):
        key, _, numbers = line.partition(":")
        if key in columns:
            values = parse_numbers(numbers.split(), name)
            if len(values) != 3 * columns[key]:
                raise ValueError(f"{name}: expected 3x{columns[key]} numbers, got {len(values)}")
            matrix = torch.eye(4, dtype=torch.float64)
            matrix[:3, : columns[key]] = torch.tensor(values, dtype=torch.float64).view(3, -1)
            found.append((key, matrix if key == "P2" else _nearest_rigid(as_pose(matrix, f"{path}: {key}"))))
    matrices = dict_of(found, f"{path}: line")
    if missing := [key for key in columns if key not in matrices]:
        raise ValueError(f"{path}: expected lines P2, R0_rect and Tr_velo_to_cam, {', '.join(missing)} missing")
    as_intrinsics(matrices["P2"][:3, :3], f"{path}: P2, first three columns")
    return matrices


def _nearest_rigid(pose: Tensor) -> Tensor:
    left, _, right = torch.linalg.svd(pose[:3, :3])
    rigid = pose.clone()
    rigid[:3, :3] = left @ right
    return rigid


def _instances(path: Path, points: Tensor, rectified_from_world: Tensor) -> Tensor:
    lines = [(name, line) for name, line in read_lines(path, "boxes") if line and line[:8] != "DontCare"]
    boxes = [_parse_box(line, name) for name, line in lines]
    height, width, length, x, y, z, yaw = torch.tensor(boxes, dtype=torch.float64).reshape(-1, 7).unbind(1)
    in_camera = points.double() @ rectified_from_world[:3, :3].T + rectified_from_world[:3, 3]
    centers = torch.stack([x, y - height / 2, z], dim=1)
    sizes = torch.stack([length, height, width], dim=1)
    return instances_in_boxes(in_camera, centers, sizes, rotations_about(1, yaw), [name for name, _ in lines])


def _parse_box(line: str, name: str) -> list[float]:
    """Height, width, length, x, y, z, yaw."""
    # type truncated occluded alpha left top right bottom height width length x y z yaw; result files add a score
    words = line.split()
    if len(words) not in (15, 16):
        raise ValueError(f"{name}: expected a type and 14 numbers, got {line[:100]!r}")
    return parse_numbers(words[8:15], name)
