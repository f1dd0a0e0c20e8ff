"""Reads ARKitScenes (Baruch et al., NeurIPS 2021): one recording of an iPad, as downloaded for 3D detection.

lowres_wide/ID_TIME.png               8-bit RGB, 256 x 192
lowres_depth/ID_TIME.png              16-bit, millimetres, 0 = unknown
lowres_wide_intrinsics/ID_TIME.pincam width height fx fy cx cy
lowres_wide.traj                      time, axis and angle, translation: world-to-camera, OpenCV axes
ID_3dod_mesh.ply                      the cloud: its vertices (optional: fused from depth if absent)
ID_3dod_annotation.json               oriented boxes of objects (optional)

The files of frames are in the folder itself or in ID_frames/. TIME is in seconds; a pose is interpolated between the
one before and the one after, and images without a pose within 0.06 s are left out. Truth: a point belongs to the
smallest box that contains it; all others are void.
"""

from functools import partial
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation
from torch import Tensor

from torchjoint.datasets.cameras import Camera, interpolate_poses, invert_pose, pinhole
from torchjoint.datasets.files.text import numbers_of, parse_numbers, read_record, read_rows, read_timed_rows
from torchjoint.datasets.recording import Options, Shot, posed, read_shots, scene_of_frames, tell_lost, without_case
from torchjoint.datasets.truth import instances_in_boxes
from torchjoint.runtime.foreign_files import has_file, has_folder
from torchjoint.runtime.threads import LazySequence
from torchjoint.scene import Frame, Scene

WHAT = "lowres_wide.traj with lowres_wide/, lowres_wide_intrinsics/, lowres_depth/, here or in ID_frames/ (ARKitScenes)"
TRAJECTORY, IMAGES, DEPTHS, CAMERAS = "lowres_wide.traj", "lowres_wide", "lowres_depth", "lowres_wide_intrinsics"
#: Poses are known ten times a second.
TOLERANCE = 0.06
#: Times of an image, its camera and its depth may differ in the last digit, seconds.
STEP = 0.001


def recognizes(path: Path) -> bool:
    return has_folder(path) and has_file(_frames_folder(path) / TRAJECTORY)


def load(path: Path, options: Options) -> Scene:
    folder, clouds = _frames_folder(path), [path / f"{path.name}_3dod_mesh.ply"]
    annotation = partial(_instances, without_case(path / f"{path.name}_3dod_annotation.json"))
    return scene_of_frames(path, _read_frames(folder), options, clouds, instances=annotation)


def _frames_folder(path: Path) -> Path:
    inside = path / f"{path.name}_frames"
    return inside if has_folder(inside) else path


def _read_frames(folder: Path) -> LazySequence[Frame]:
    files = [(file.stem.rpartition("_")[2], file) for file in (folder / IMAGES).glob("[!.]*.png")]
    images = sorted((parse_numbers([time], f"{file}: time in the name")[0], file) for time, file in files)
    poses = _read_poses(folder / TRAJECTORY, [time for time, _ in images])
    cameras = {file: _near(folder / CAMERAS, file.stem, ".pincam") for _, file in images}
    tell_lost(str(folder), (folder / CAMERAS).glob("[!.]*.pincam"), cameras.values())
    shots = [
        Shot(file, _camera(cameras[file]), invert_pose(pose), file.stem, _near(folder / DEPTHS, file.stem, ".png"))
        for (_, file), pose in posed(list(zip(images, poses, strict=True)), str(folder), TRAJECTORY, TOLERANCE)
    ]
    return read_shots(shots)


def _read_poses(file: Path, times: list[float]) -> list[Tensor | None]:
    """Camera-to-world poses at these times."""
    table = read_timed_rows(file, "7 numbers", 7)
    to_world = Rotation.from_rotvec(table[:, 1:4]).inv()
    poses = np.concatenate([table[:, :1], -to_world.apply(table[:, 4:]), to_world.as_quat()], axis=1)
    return interpolate_poses(poses, np.array(times, dtype=np.float64), TOLERANCE, str(file))


def _near(folder: Path, stem: str, suffix: str) -> Path:
    """The file of an image, which may have another time in its name."""
    identifier, _, time = stem.rpartition("_")
    near = (folder / f"{identifier}_{float(time) + shift:.3f}{suffix}" for shift in (0, -STEP, STEP))
    return next(filter(has_file, near), folder / f"{stem}{suffix}")


def _camera(file: Path) -> Camera:
    rows = read_rows(file, "width height fx fy cx cy", 6)
    if len(rows) != 1:
        raise ValueError(f"{file}: expected one line of width height fx fy cx cy, got {len(rows)}")
    return pinhole([*rows[0][1][2:], *rows[0][1][:2]], str(file))


def _instances(file: Path, points: Tensor) -> Tensor | None:
    if not has_file(file):
        return None
    boxes = [one.record("segments").record("obbAligned") for one in read_record(file, "boxes").records("data")]
    centers, sizes = (numbers_of(boxes, key, 3) for key in ("centroid", "axesLengths"))
    axes = numbers_of(boxes, "normalizedAxes", 9).view(-1, 3, 3)  # one axis a row
    return instances_in_boxes(points, centers, sizes, axes.mT, [box.name for box in boxes])
