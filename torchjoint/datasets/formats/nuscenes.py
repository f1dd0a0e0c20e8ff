"""Reads a sample of nuScenes (H. Caesar et al., CVPR 2020) in MMDetection3D's format: a LiDAR scan and six images.

sample.json, with these keys:

lidar.lidar_path, lidar.num_pts_feats   LiDAR scan, rows of `num_pts_feats` float32, x, y, z first, in the world frame
cameras.NAME.img_path                   image
cameras.NAME.cam2img                    3x3 intrinsics
cameras.NAME.lidar2cam                  4x4, the pose: LiDAR frame to camera frame
instances[].bbox_3d                     x, y, z of the centre, length, width, height, yaw about z, in the LiDAR frame

The world frame is the LiDAR's frame. Paths are relative to the folder and must stay in it. Returns from the car itself
(within about a metre) are kept.

Ground truth: a point in a box gets the box's index in `instances`, and where boxes overlap the smallest box; all other
points are void. The images have no ground truth.
"""

from pathlib import Path

from torch import Tensor

from torchjoint.datasets.cameras import Camera, rotations_about
from torchjoint.datasets.files.clouds import COLUMNS, read_scan
from torchjoint.datasets.files.text import Record, numbers_of, path_inside, read_record
from torchjoint.datasets.recording import Options, Shot, read_shots
from torchjoint.datasets.truth import instances_in_boxes
from torchjoint.runtime.foreign_files import has_file, has_folder, present
from torchjoint.scene import Scene, Truth
from torchjoint.scene.checks import as_pose

WHAT = "a sample of nuScenes: sample.json (MMDetection3D) with its scan and images"


def recognizes(path: Path) -> bool:
    return has_folder(path) and has_file(path / "sample.json")


def load(path: Path, options: Options) -> Scene:
    sample = read_record(path / "sample.json", "a sample of nuScenes")
    lidar = sample.record("lidar")
    columns = lidar.number("num_pts_feats")
    if columns not in COLUMNS:
        raise ValueError(f"{lidar.name}: num_pts_feats: expected 3 to 7, got {columns:g}")
    file = path_inside(path, lidar.text("lidar_path"), lidar.name)
    points = read_scan(file, int(columns), options.invalid, plausible=True)[:, :3]
    cameras = sample.record("cameras")
    frames = read_shots([_shot(path, cameras.record(name), name) for name in cameras.values])
    truth = Truth(_instances(sample.records("instances"), points)) if "instances" in sample else None
    return Scene(points, frames, name=path.name, truth=truth)


def _shot(path: Path, camera: Record, name: str) -> Shot:
    image = present(path_inside(path, camera.text("img_path"), camera.name), f"the image of {camera.name}")
    pose = as_pose(camera.matrix("lidar2cam", 4), f"{camera.name}: lidar2cam")
    return Shot(image, Camera(camera.matrix("cam2img", 3), name=f"{camera.name}: cam2img"), pose, name)


def _instances(records: list[Record], points: Tensor) -> Tensor:
    boxes = numbers_of(records, "bbox_3d", 7)
    names = [f"{record.name}: bbox_3d" for record in records]
    return instances_in_boxes(points, boxes[:, :3], boxes[:, 3:6], rotations_about(2, boxes[:, 6]), names)
