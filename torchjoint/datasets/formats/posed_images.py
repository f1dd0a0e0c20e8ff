"""Reads posed_images/SCAN, the frames of ScanNet as MMDetection3D and its followers export them.

NNNNN.jpg, NNNNN.png, NNNNN.txt    8-bit RGB; depth, 16-bit, millimetres (optional); 4x4 camera-to-world, -inf = lost
intrinsic.txt                      4x4 (or 3x3), of the images
depth_intrinsic.txt                4x4 (or 3x3), of the depth images (optional: else intrinsic.txt, scaled)
SCAN_vh_clean_2.ply                the cloud, with ScanNet's annotation (optional; here, or in scans/SCAN beside
                                   posed_images/; fused from depth if absent)
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from torchjoint.datasets.files.readers import read_depth, read_image, read_matrix
from torchjoint.datasets.formats.scannet import CLOUD, make_frame
from torchjoint.datasets.recording import Options, find_cloud, invert_pose, scene_of_frames, tell_left_out
from torchjoint.datasets.scannet_cameras import COLOR_SIZE, DEPTH_SIZE, Calibration, Cameras
from torchjoint.datasets.scannet_truth import has_point_instances, read_point_instances
from torchjoint.runtime.foreign_files import has_file, has_folder, read_text
from torchjoint.runtime.threads import LazySequence
from torchjoint.scene import Frame, Scene, Truth
from torchjoint.scene.checks import as_intrinsics, as_pose

WHAT = "intrinsic.txt with NNNNN.jpg and NNNNN.txt (posed_images)"


def recognizes(path: Path) -> bool:
    """Returns whether the folder has images, poses and intrinsics side by side."""
    return has_folder(path) and has_file(path / "intrinsic.txt") and bool(_images(path))


def load(path: Path, options: Options) -> Scene:
    """Loads a scan; see :func:`torchjoint.load_scene`."""
    scan, beside = path.name, path.absolute().parent.parent / "scans" / path.name
    folder = path if has_file(path / f"{scan}{CLOUD}") else beside
    cloud = folder / f"{scan}{CLOUD}"
    scene = scene_of_frames(path, _read_frames(path), options, [cloud])
    if find_cloud(path, options, [cloud]) != cloud or not has_point_instances(folder, scan):
        return scene
    return replace(scene, truth=Truth(read_point_instances(folder, scan, len(scene.points))))


def _read_frames(path: Path) -> LazySequence[Frame]:
    images = _images(path)
    color = _calibration(path / "intrinsic.txt")
    of_depth = path / "depth_intrinsic.txt"
    cameras = Cameras(color, _calibration(of_depth) if has_file(of_depth) else color)
    poses = [read_matrix(file.with_suffix(".txt"), (4, 4)) for file in images]
    kept = [index for index, pose in enumerate(poses) if torch.isfinite(pose).all()]
    tell_left_out(str(path), len(images) - len(kept), len(images))
    extrinsics = {i: invert_pose(as_pose(poses[i], str(images[i].with_suffix(".txt")))) for i in kept}

    def read(place: int) -> Frame:
        file = images[kept[place]]
        depth = read_depth(file.with_suffix(".png")) if has_file(file.with_suffix(".png")) else None
        return make_frame(file.stem, read_image(file), depth, cameras, extrinsics[kept[place]])

    return LazySequence(len(kept), read, [images[i].stem for i in kept])


def _images(path: Path) -> list[Path]:
    images = (file for file in path.iterdir() if file.suffix == ".jpg" and file.stem.isascii() and file.stem.isdigit())
    return sorted(images, key=lambda file: (int(file.stem), file.stem))


def _calibration(file: Path) -> Calibration:
    text = read_text(file, "a description", errors="replace")
    side = 3 if len(text.replace(",", " ").split()) == 9 else 4
    matrix: Tensor = read_matrix(file, (side, side))[:3, :3]
    return Calibration(as_intrinsics(matrix, str(file)), (COLOR_SIZE, DEPTH_SIZE), is_certain=False)
