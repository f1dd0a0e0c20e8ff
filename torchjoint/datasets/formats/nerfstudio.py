"""Reads transforms.json of nerfstudio and instant-ngp (docs.nerf.studio, "Data conventions").

transforms.json          `frames`, each with `file_path` and `transform_matrix`: camera-to-world, 4x4, OpenGL axes (y
                         up, z back). Intrinsics `fl_x fl_y cx cy w h`, or `camera_angle_x`, and distortion `k1 k2 p1 p2
                         k3` (of a fisheye `k1 k2 k3 k4`; or `distortion_params`: k1 k2 k3 k4 p1 p2) are given per
                         frame, or once for all frames. Pixel centres are at 1/2.
images, anywhere below   8-bit; a `file_path` without suffix means a .png, or else a .jpg
`depth_file_path`        of a frame (optional): depth along z at any resolution. A 16-bit .png, or a .npy of integers,
                         has units of `depth_unit_scale_factor` metres (default 0.001); a .npy of floating numbers is in
                         metres, times this factor if the file gives one
`ply_file_path`          the cloud (optional), in the world frame of `transform_matrix`. nerfstudio writes it after
                         applying `applied_transform`, so `applied_transform` is ignored. A cloud.ply has precedence;
                         without either, a cloud is fused from depth

The scale of poses from structure from motion is arbitrary: "metres" are then the unit of the file.
Files are searched below the folder of transforms.json and in its sibling folder `images`; nowhere else.
"""

import math
import warnings
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import torch
from torch import Tensor

from torchjoint.datasets.cameras import Camera, pinhole_matrix, world_to_camera
from torchjoint.datasets.files.readers import read_array, read_depth, read_image_size
from torchjoint.datasets.files.text import Record, frame_names, path_inside, read_record
from torchjoint.datasets.recording import Options, Shot, find_cloud, read_shots, scene_of_frames, tell_unlisted
from torchjoint.runtime import bounds
from torchjoint.runtime.foreign_files import has_file, has_folder, no_twice, present
from torchjoint.scene import Frame, Scene

WHAT = "transforms.json, as of nerfstudio (or a file of that kind itself)"

_MODELS = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "RADIAL", "SIMPLE_RADIAL", "OPENCV_FISHEYE")
_FOCAL = {"fl_x", "fl_y", "camera_angle_x", "camera_angle_y"}
#: Of a `file_path` without suffix, in this order.
_SUFFIXES = (".png", ".jpg", ".jpeg", ".JPG", ".PNG")


def recognizes(path: Path) -> bool:
    is_file = path.suffix == ".json" and path.name.startswith("transforms")
    return has_file(path) if is_file else has_file(path / "transforms.json")


def scenes(path: Path) -> dict[str, Path]:
    """Returns the files of a folder without transforms.json, such as transforms_train.json of Blender's sets."""
    return {file.stem.removeprefix("transforms_"): file for file in sorted(path.glob("transforms_*.json"))}


def load(path: Path, options: Options) -> Scene:
    file = path / "transforms.json" if has_folder(path) else path
    record = read_record(file, "poses as of nerfstudio")
    clouds = [_inside(file, record, "ply_file_path")] if "ply_file_path" in record else []
    if clouds and find_cloud(file.parent, options, clouds) is None:
        present(clouds[0], f"the cloud that {file} gives as ply_file_path")
    return scene_of_frames(file.parent, read_frames(file, record), options, clouds)


def read_frames(file: Path, record: Record) -> Sequence[Frame]:
    """Returns the frames of transforms.json, sorted by file name; each frame is read on access."""
    for_all = {key: value for key, value in _with_lens(record).values.items() if key != "frames"}
    bounds.check(len(for_all) * len(record.records("frames")), bounds.PAIRS, "values of all frames", str(file))
    shared = {key: value for key, value in for_all.items() if key not in _FOCAL}  # with a frame of its own focal length
    frames = [
        Record((for_all if _FOCAL.isdisjoint(frame.values) else shared) | dict(_with_lens(frame).values), frame.name)
        for frame in record.records("frames")
    ]
    shots = sorted((_shot(file, frame) for frame in frames), key=lambda pair: pair[0])
    if not shots:
        raise ValueError(f"{file}: frames: expected at least one, got none")
    no_twice((one.text("depth_file_path") for one in frames if "depth_file_path" in one), f"{file}: depth image")
    tell_unlisted(str(file), [color for color, _ in shots])
    if unread := [key for key in ("mask_path", "depth_path") if any(key in frame for frame in frames)]:
        warnings.warn(f"{file}: not read: {', '.join(unread)} (depth_file_path, segment --masks are)", stacklevel=2)
    names = frame_names([str(color) for color, _ in shots])
    return read_shots([shot._replace(name=name) for (_, shot), name in zip(shots, names, strict=True)])


def _shot(file: Path, frame: Record) -> tuple[Path, Shot]:
    color = _inside(file, frame, "file_path")
    named = [color, *(color.with_name(color.name + suffix) for suffix in _SUFFIXES)]
    color = next((one for one in named if has_file(one)), color)
    depth = _inside(file, frame, "depth_file_path") if "depth_file_path" in frame else None
    for needed in filter(None, (color, depth)):
        present(needed, f"an image that {frame.name} gives")
    unit = frame.number("depth_unit_scale_factor") if "depth_unit_scale_factor" in frame else None
    if unit is not None and unit <= 0:
        raise ValueError(f"{frame.name}: depth_unit_scale_factor: expected the metres per unit, above 0, got {unit}")
    pose = world_to_camera(frame.matrix("transform_matrix", 4), f"{frame.name}: transform_matrix", opengl=True)
    read = None if depth is None else partial(_read_depth, depth, unit)
    return color, Shot(color, read_camera(frame, color), pose, color.name, read)


def _read_depth(path: Path, unit: float | None) -> Tensor:
    if path.suffix.lower() != ".npy":
        return read_depth(path, 0.001 if unit is None else unit)
    values = read_array(path)
    if values.ndim == 3 and values.shape[2] == 1:
        values = values[..., 0]
    if values.is_complex() or values.dtype == torch.bool:
        raise ValueError(f"{path}: expected numbers, got {values.dtype}")
    if unit is None:
        unit = 1.0 if values.is_floating_point() else 0.001
    depth = values.to(torch.float32) * unit
    is_known = torch.isfinite(depth) & (depth > 0) & ((values != 65535) | values.is_floating_point())  # as in a .png
    return torch.where(is_known, depth, 0.0)


def read_camera(frame: Record, color: Path) -> Camera:
    """Returns the camera of a frame, whose size is that of the image `color` if the frame does not give it."""
    frame = _with_lens(frame)
    model = frame.text("camera_model", "OPENCV")
    if model not in _MODELS:
        told = f"{frame.name}: camera_model: expected one of {', '.join(_MODELS)}, got {model!r}"
        raise ValueError(f"{told}; undistort the images first")
    said = frame.values["is_fisheye"] if "is_fisheye" in frame else False
    if said not in (True, False):
        raise ValueError(f"{frame.name}: is_fisheye: expected true or false, got {str(said)[:60]!r}")
    fisheye = model == "OPENCV_FISHEYE" or bool(said)
    for key in ("k5", "k6", "skew", "ftheta_p1", *(("p1", "p2") if fisheye else ("k4",))):
        if frame.number(key, 0.0) != 0:
            kind = "fisheye" if fisheye else "perspective"
            raise ValueError(f"{frame.name}: {key}: expected 0 for a {kind} camera, got {frame.number(key)}")
    size = _size(frame) if "w" in frame and "h" in frame else read_image_size(color)
    fl_x, fl_y = _focal_lengths(frame, size)
    matrix = pinhole_matrix(fl_x, fl_y, frame.number("cx", size[1] / 2), frame.number("cy", size[0] / 2), center=0.5)
    keys = ("k1", "k2", "k3", "k4") if fisheye else ("k1", "k2", "p1", "p2", "k3")
    return Camera(matrix, size, tuple(frame.number(key, 0.0) for key in keys), frame.name, fisheye)


def _with_lens(record: Record) -> Record:
    """A record with the numbers of its `distortion_params` by their names."""
    given = record.numbers("distortion_params", 6).tolist() if "distortion_params" in record else []
    named = dict(zip(("k1", "k2", "k3", "k4", "p1", "p2"), given, strict=False))
    for key, value in named.items():
        if record.number(key, value) not in (value, 0):
            raise ValueError(f"{record.name}: {key}: expected {value} as in distortion_params, or 0, got another")
    return Record({**record.values, **named, "distortion_params": None}, record.name)


def _focal_lengths(frame: Record, size: tuple[int, int]) -> tuple[float, float]:
    if "fl_x" in frame:
        return frame.number("fl_x"), frame.number("fl_y", frame.number("fl_x"))
    if "camera_angle_x" not in frame:
        raise ValueError(f"{frame.name}: expected fl_x or camera_angle_x, got neither")
    fl_x = _focal_length(frame, "camera_angle_x", size[1])
    return fl_x, _focal_length(frame, "camera_angle_y", size[0]) if "camera_angle_y" in frame else fl_x


def _focal_length(frame: Record, key: str, pixels: int) -> float:
    angle = frame.number(key)
    if not 0 < angle < math.pi:
        raise ValueError(f"{frame.name}: {key}: expected an angle of view in radians, 0 to pi, got {angle}")
    return pixels / 2 / math.tan(angle / 2)


def _size(frame: Record) -> tuple[int, int]:
    width, height = frame.number("w"), frame.number("h")
    if not (1 <= width < 1e6 and 1 <= height < 1e6):
        raise ValueError(f"{frame.name}: w, h: expected a size in pixels, got {width} x {height}")
    return round(height), round(width)


def _inside(file: Path, record: Record, key: str) -> Path:
    beside = Path(file.parent.absolute().parent, "images")
    return path_inside(file.parent, record.text(key), f"{record.name}: {key}", or_inside=[beside])
