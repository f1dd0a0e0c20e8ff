"""Reads a plain folder in the style of 7-Scenes (J. Shotton et al., CVPR 2013).

camera-intrinsics.txt          3x3, of the colour images
frame-NNNNNN.color.jpg|png     8-bit RGB
frame-NNNNNN.pose.txt          4x4, camera-to-world, OpenCV axes
frame-NNNNNN.depth.png         16-bit, millimetres, registered to colour; 0 and 65535 = unknown (optional)
frame-NNNNNN.labels.png        8- or 16-bit initial segmentation; 0 = none (optional)
frame-NNNNNN.truth.png         8- or 16-bit ground-truth instances; 0 = void (optional; all frames or none)
cloud.ply                      the point cloud, also .pcd, .las, .laz or .e57 (optional: fused from depth if absent)
cloud.truth.npy                ground-truth instances of the points, integers [N]; -1 = void (optional)
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from torch import Tensor

from torchjoint.datasets.cameras import world_to_camera
from torchjoint.datasets.files.readers import read_array, read_depth, read_image, read_label_image, read_matrix
from torchjoint.datasets.recording import Frames, Options, find_cloud, scene_of_frames, sorted_images
from torchjoint.datasets.truth import label_images
from torchjoint.runtime.foreign_files import has_file, has_folder, no_twice
from torchjoint.scene import Frame, Scene, Truth
from torchjoint.scene.checks import as_labels

WHAT = "camera-intrinsics.txt and frame-NNNNNN.color.jpg (or .png) with frame-NNNNNN.pose.txt"
_COLOR = (".color.jpg", ".color.jpeg", ".color.png")


def recognizes(path: Path) -> bool:
    return has_folder(path) and bool(_color_files(path))


def load(path: Path, options: Options) -> Scene:
    frames = read_frames(path)
    scene = scene_of_frames(path, frames, options)
    if not options.fuse and find_cloud(path, options) is None:
        return scene  # the truth is that of another cloud
    return replace(scene, truth=_truth(path, frames.names, len(scene.points)))


def read_frames(path: Path) -> Frames:
    """Returns the frames of a folder; each frame is read on access."""
    colors = sorted_images(path, _color_files(path))
    stems = [file.name.split(".")[0] for file in colors]
    no_twice(stems, f"{path}: the colour image of frame")
    lost = {file.name.split(".")[0] for file in path.glob("frame-*.pose.txt")}.difference(stems)
    if lost:
        warnings.warn(
            f"{path}: {len(lost)} of {len(lost) + len(stems)} poses have no colour image and are left out: {min(lost)}"
            f"{', ...' if len(lost) > 1 else ''}",
            stacklevel=2,
        )
    pose_files = [_beside(file, ".pose.txt") for file in colors]
    for file in pose_files:
        if not has_file(file):
            raise FileNotFoundError(f"{file}: missing; every colour frame needs its pose")
    # Reads all poses at once: a bad pose must be found before hours of work, not after.
    poses = [world_to_camera(read_matrix(file, (4, 4)), str(file)) for file in pose_files]
    intrinsics = read_matrix(path / "camera-intrinsics.txt", (3, 3))
    depths = [_beside(file, ".depth.png") for file in colors]
    return Frames(
        len(colors), lambda i: _read_frame(colors[i], intrinsics, poses[i]), stems, lambda i: has_file(depths[i])
    )


def _read_frame(file: Path, intrinsics: Tensor, world_to_camera: Tensor) -> Frame:
    depth, labels = _beside(file, ".depth.png"), _beside(file, ".labels.png")
    return Frame(
        read_image(file),
        intrinsics,
        world_to_camera,
        depth=read_depth(depth) if has_file(depth) else None,
        labels=read_label_image(labels) - 1 if has_file(labels) else None,
        name=file.name.split(".")[0],
    )


def _truth(path: Path, names: Sequence[str], num_points: int) -> Truth | None:
    of_points, images = path / "cloud.truth.npy", label_images([path / f"{name}.truth.png" for name in names], "truth")
    points = as_labels(read_array(of_points), (num_points,), str(of_points)) if has_file(of_points) else None
    return Truth(points, images) if images or points is not None else None


def _color_files(path: Path) -> list[Path]:
    return [file for file in path.iterdir() if file.name.startswith("frame-") and file.name.endswith(_COLOR)]


def _beside(color_file: Path, suffix: str) -> Path:
    return color_file.with_name(color_file.name.split(".")[0] + suffix)
