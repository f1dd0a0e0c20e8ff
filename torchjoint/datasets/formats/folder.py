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

import re
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from torchjoint.datasets import recording
from torchjoint.datasets.cameras import Camera, world_to_camera
from torchjoint.datasets.files.readers import read_array, read_matrix
from torchjoint.datasets.truth import label_images
from torchjoint.runtime.foreign_files import has_file, has_folder
from torchjoint.scene import Scene, Truth
from torchjoint.scene.checks import as_labels

WHAT = "camera-intrinsics.txt and frame-NNNNNN.color.jpg (or .png) with frame-NNNNNN.pose.txt"


def recognizes(path: Path) -> bool:
    return has_folder(path) and bool(_files(path))


def load(path: Path, options: recording.Options) -> Scene:
    frames = read_frames(path)
    scene = recording.scene_of_frames(path, frames, options)
    if not options.fuse and recording.find_cloud(path, options) is None:
        return scene  # the truth is that of another cloud
    return replace(scene, truth=_truth(path, frames.names, len(scene.points)))


def read_frames(path: Path) -> recording.Frames:
    """Returns the frames of a folder; each frame is read on access."""
    images = recording.sorted_images(path, _files(path))
    found = [_stem(one).lower() for one in images]
    recording.tell_lost(str(path), (_stem(one).lower() for one in _files(path, r"pose\.txt")), found)
    # Reads all poses at once: a bad pose must be found before hours of work, not after. A lost one may be NaN or -inf.
    files = {color: file for color in images if has_file(file := _beside(color, ".pose.txt"))}
    read = {color: read_matrix(file, (4, 4)) for color, file in files.items()}
    poses = {one: world_to_camera(pose, str(files[one])) for one, pose in read.items() if pose.isfinite().all()}
    if found and not poses:
        raise FileNotFoundError(f"{path}: none of {len(found)} colour images has a pose, a file NAME.pose.txt")
    lost = [_stem(color) for color in images if color not in poses]
    recording.tell_left_out(f"{path}: {', '.join(lost[:9])}", len(lost), len(found))
    file = recording.without_case(path / "camera-intrinsics.txt")
    camera = Camera(read_matrix(file, (3, 3)), name=str(file))
    beside = [[_beside(color, f".{what}.png") for what in ("depth", "labels")] for color in poses]
    without = sum(not has_file(labels) for _, labels in beside)
    if without == len(poses):
        recording.tell_not_read(path, "label", "an image of labels")
    elif without:
        warnings.warn(f"labels: {without} of {len(poses)} frames have no .labels.png", stacklevel=4)
    shots = [
        recording.Shot(color, camera, pose, _stem(color), depth, labels=labels, first=next(iter(poses)))
        for (color, pose), (depth, labels) in zip(poses.items(), beside, strict=True)
    ]
    return recording.read_shots(shots)


def _truth(path: Path, names: Sequence[str], num_points: int) -> Truth | None:
    colors = [file for file in recording.sorted_images(path, _files(path)) if _stem(file) in names]
    of_points = recording.without_case(path / "cloud.truth.npy")
    images = label_images([_beside(file, ".truth.png") for file in colors], "truth", colors)
    points = as_labels(read_array(of_points), (num_points,), str(of_points)) if has_file(of_points) else None
    return Truth(points, images) if images or points is not None else None


def _files(path: Path, kind: str = r"color\.(jpe?g|png)") -> list[Path]:
    return [file for file in path.iterdir() if re.fullmatch(rf"(?is)frame-.*\.{kind}", file.name)]


def _stem(file: Path) -> str:
    return file.name.split(".")[0]


def _beside(color_file: Path, suffix: str) -> Path:
    return recording.without_case(color_file.with_name(_stem(color_file) + suffix))
