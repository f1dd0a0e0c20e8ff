"""Reads COLMAP's sparse models, text and binary (colmap.github.io/format.html).

cameras     id, model, width, height, parameters; pixel centres are at 1/2
images      id, pose world-to-camera (OpenCV axes) as quaternion w x y z and translation, camera id, name, 2D points
points3D    id, position, colour, error, track
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchjoint.datasets.cameras import Camera, pinhole_matrix, rotations_from_quaternions
from torchjoint.datasets.files.binary import BinaryFile
from torchjoint.datasets.files.text import parse_integer, parse_numbers, read_lines
from torchjoint.runtime.foreign_files import dict_of, has_file, no_twice

#: Camera models; the index is the model's number in binary files.
MODELS = (
    "SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE", "FULL_OPENCV", "FOV",
    "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "THIN_PRISM_FISHEYE", "RAD_TAN_THIN_PRISM_FISHEYE",
)  # fmt: skip

#: Camera models that OpenCV can undistort: number of focal lengths (they come first, then cx, cy) and of parameters.
_PARAMETERS = {
    "SIMPLE_PINHOLE": (1, 3),
    "PINHOLE": (2, 4),
    "SIMPLE_RADIAL": (1, 4),
    "RADIAL": (1, 5),
    "OPENCV": (2, 8),
    "FULL_OPENCV": (2, 12),
    "OPENCV_FISHEYE": (2, 8),
    "SIMPLE_RADIAL_FISHEYE": (1, 4),
    "RADIAL_FISHEYE": (1, 5),
}


class ColmapImage(NamedTuple):
    """An image with its camera and pose."""

    name: str  #: relative to the image folder
    camera: Camera
    world_to_camera: Tensor  #: [4, 4] float64


class _Row(NamedTuple):
    pose: list[float]  # quaternion w x y z, translation
    camera: int
    name: str


_Point = tuple[float, ...]  # id, position, colour


def has_model(folder: Path) -> bool:
    """Returns whether a folder holds a sparse model."""
    return all(any(has_file(folder / f"{part}.{kind}") for kind in ("bin", "txt")) for part in ("cameras", "images"))


def read_images(folder: Path) -> list[ColmapImage]:
    """Returns the images of a model, sorted by name."""
    cameras_file, images_file = _file(folder, "cameras"), _file(folder, "images")
    cameras = _cameras_of_binary(cameras_file) if cameras_file.suffix == ".bin" else _cameras_of_text(cameras_file)
    rows = _images_of_binary(images_file) if images_file.suffix == ".bin" else _images_of_text(images_file)
    if not rows:
        raise ValueError(f"{images_file}: expected images with poses, got none")
    rows.sort(key=lambda row: row.name)
    no_twice((row.name for row in rows), f"{images_file}: image")
    for row in rows:
        if row.camera not in cameras:
            raise ValueError(f"{images_file}: image {row.name!r} is of camera {row.camera}, which {cameras_file} lacks")
    poses = _poses(np.array([row.pose for row in rows]), str(images_file))
    return [ColmapImage(row.name, cameras[row.camera], pose) for row, pose in zip(rows, poses, strict=True)]


def read_points(folder: Path) -> tuple[Tensor, Tensor]:
    """Returns the sparse points of a model, sorted by id: positions [N, 3] float64 and colours [N, 3] uint8."""
    file = _file(folder, "points3D")
    rows = _points_of_binary(file) if file.suffix == ".bin" else _points_of_text(file)
    if not rows:
        raise ValueError(f"{file}: expected points, got none")
    values = torch.tensor([row[1:] for row in sorted(rows)], dtype=torch.float64)
    colors = values[:, 3:]
    if not ((colors >= 0) & (colors <= 255)).all():
        raise ValueError(f"{file}: expected colours of 0 to 255, got {colors.min():g} to {colors.max():g}")
    return values[:, :3], colors.to(torch.uint8)


def _file(folder: Path, part: str) -> Path:
    binary = folder / f"{part}.bin"
    return binary if has_file(binary) else folder / f"{part}.txt"  # COLMAP, too, prefers the binary file


def _poses(rows: npt.NDArray[np.float64], name: str) -> Tensor:
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3, :3] = rotations_from_quaternions(rows[:, [1, 2, 3, 0]], name).as_matrix()
    poses[:, :3, 3] = rows[:, 4:]
    return torch.from_numpy(poses)


def _camera(model: str, width: int, height: int, parameters: Sequence[float], name: str) -> Camera:
    num_focal, num_parameters = _check_model(model, name)
    if len(parameters) != num_parameters:
        raise ValueError(f"{name}: expected {num_parameters} parameters of {model}, got {len(parameters)}")
    focal, (cx, cy), distortion = np.split(np.array(parameters), [num_focal, num_focal + 2])
    # Radial models have the first coefficients of OpenCV's k1 k2 p1 p2, or of a fisheye's k1 k2 k3 k4.
    matrix = pinhole_matrix(float(focal[0]), float(focal[-1]), float(cx), float(cy), center=0.5)
    coefficients = tuple(distortion.tolist()) + (0.0,) * max(4 - len(distortion), 0)
    return Camera(matrix, (height, width), coefficients, name, fisheye=model.endswith("FISHEYE"))


def _check_model(model: str, name: str) -> tuple[int, int]:
    if model not in _PARAMETERS:
        raise ValueError(
            f"{name}: expected a camera model of {', '.join(_PARAMETERS)}, got {model[:40]}; "
            "`colmap image_undistorter` makes undistorted images and a model of PINHOLE cameras"
        )
    return _PARAMETERS[model]


def _cameras_of_text(path: Path) -> dict[int, Camera]:
    cameras = []
    for name, line in read_lines(path, "COLMAP's cameras"):
        if not line:
            continue
        words = line.split()
        if len(words) < 5:
            raise ValueError(f"{name}: expected CAMERA_ID MODEL WIDTH HEIGHT PARAMS, got {line[:100]!r}")
        key, width, height = (parse_integer(word, name) for word in (words[0], words[2], words[3]))
        cameras.append((key, _camera(words[1], width, height, parse_numbers(words[4:], name), name)))
    return dict_of(cameras, f"{path}: camera")


def _images_of_text(path: Path) -> list[_Row]:
    rows = []
    lines = read_lines(path, "COLMAP's images")
    for name, line in lines:
        if not line:
            continue
        words = line.split(maxsplit=9)
        if len(words) < 10:
            raise ValueError(f"{name}: expected IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, got {line[:100]!r}")
        rows.append(_Row(parse_numbers(words[1:8], name), parse_integer(words[8], name), words[9]))
        name, points = next(lines, (name, ""))
        if len(points.split()) % 3:
            told = "expected 2D points X Y POINT3D_ID of the image above, or an empty line"
            raise ValueError(f"{name}: {told}, got {points[:80]!r}")
    return rows


def _points_of_text(path: Path) -> list[_Point]:
    points: list[_Point] = []
    for name, line in read_lines(path, "COLMAP's 3D points"):
        if not line:
            continue
        words = line.split(maxsplit=7)
        if len(words) < 8:
            raise ValueError(f"{name}: expected POINT3D_ID X Y Z R G B ERROR TRACK, got {line[:100]!r}")
        points.append((parse_integer(words[0], name), *parse_numbers(words[1:7], name)))
    return points


def _cameras_of_binary(path: Path) -> dict[int, Camera]:
    cameras = []
    with BinaryFile(path) as file:
        for _ in range(file.count(smallest=48)):
            key, number, width, height = file.read("IiQQ")
            name = f"{path}: camera {key}"
            model = MODELS[number] if 0 <= number < len(MODELS) else f"number {number}"
            parameters = file.read(f"{_check_model(model, name)[1]}d")
            cameras.append((key, _camera(model, width, height, parameters, name)))
        file.finish()
    return dict_of(cameras, f"{path}: camera")


def _images_of_binary(path: Path) -> list[_Row]:
    rows = []
    with BinaryFile(path) as file:
        for _ in range(file.count(smallest=73)):
            _, *pose, camera = file.read("I7dI")
            rows.append(_Row(pose, camera, file.text()))
            file.skip(24 * file.count(smallest=24))  # the image's 2D points
        file.finish()
    return rows


def _points_of_binary(path: Path) -> list[_Point]:
    points: list[_Point] = []
    with BinaryFile(path) as file:
        for _ in range(file.count(smallest=51)):
            points.append(file.read("Q3d3Bd")[:7])
            file.skip(8 * file.count(smallest=8))  # the point's track
        file.finish()
    return points
