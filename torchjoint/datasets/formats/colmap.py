"""Reads COLMAP's reconstructions (J. Schönberger, J.-M. Frahm, "Structure-from-Motion Revisited", CVPR 2016).

sparse/N, sparse, or the folder itself    the model: cameras, images and points3D, .bin or .txt; of several sparse/N the
                                          one with most images, which a warning tells. rigs and frames of COLMAP 3.12
                                          and later are not needed: images have whole poses there, too
images, or images_2, _4, _8               the images, in the first folder that holds the model's names; or in the folder
                                          itself
cloud.ply, fused.ply, dense/fused.ply,    the cloud, the first that exists; otherwise the model's sparse points, which
dense/N/fused.ply                         are few for a segmentation; N is that of sparse/N; of several models only this

If the given folder is the model itself, images and clouds are also searched in its parent and grandparent folders.
Of a camera, pixel centres are at 1/2; of an image, the pose is world-to-camera, a quaternion w x y z and a translation.
Images may be resized, but not cropped; lens distortion is removed. The scale of a reconstruction is arbitrary: its
"metres" are the model's unit, unless the model was aligned.
"""

import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np
import torch
from torch import Tensor

from torchjoint.datasets.cameras import Camera, pinhole_matrix, poses_from_quaternions
from torchjoint.datasets.files.binary import BinaryFile
from torchjoint.datasets.files.text import fields, frame_names, parse_integer, parse_numbers, path_inside, read_lines
from torchjoint.datasets.recording import Options, Shot, find_cloud, read_shots, scene_of_frames, tell_unlisted
from torchjoint.runtime.foreign_files import dict_of, has_file, has_folder, no_twice, present
from torchjoint.scene import Frame, Scene
from torchjoint.scene.checks import Invalid, kept_points

WHAT = "COLMAP's cameras and images (.bin or .txt) in sparse/0/, in sparse/, or in the folder itself"

_IMAGES = ("images", "images_2", "images_4", "images_8", ".")
#: Camera models; the index is the model's number in binary files.
MODELS = (
    "SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE", "FULL_OPENCV", "FOV",
    "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "THIN_PRISM_FISHEYE", "RAD_TAN_THIN_PRISM_FISHEYE",
)  # fmt: skip

#: Camera models that OpenCV can undistort: number of focal lengths (they come first, then cx, cy) and of parameters.
_PARAMETERS = {
    "SIMPLE_PINHOLE": (1, 3), "PINHOLE": (2, 4), "SIMPLE_RADIAL": (1, 4), "RADIAL": (1, 5), "OPENCV": (2, 8),
    "FULL_OPENCV": (2, 12), "OPENCV_FISHEYE": (2, 8), "SIMPLE_RADIAL_FISHEYE": (1, 4), "RADIAL_FISHEYE": (1, 5),
}  # fmt: skip


def recognizes(path: Path) -> bool:
    return has_folder(path) and bool(_models(path))


def load(path: Path, options: Options) -> Scene:
    models = _models(path)
    model = _largest(path, models)
    around = list(path.absolute().parents)[:2] if model == path else []
    frames = _read_frames(model, [path, *around])
    number = model.name if model.name.isdigit() else "0"
    names = ["fused.ply", "dense/fused.ply"] if len(models) == 1 and number == "0" else []
    clouds = [base / name for base in (path, *around) for name in (*names, f"dense/{number}/fused.ply")]
    if find_cloud(path, options, clouds) is not None:
        return scene_of_frames(path, frames, options, clouds)
    points, colors = read_points(model, options.invalid)
    return Scene(points, frames, colors, name=path.name)


def _models(path: Path) -> list[Path]:
    """The models of which one is read: COLMAP numbers those of parts that it could not join."""
    numbered = (path / "sparse").glob("[0-9]*") if has_folder(path / "sparse") else ()
    parts = sorted((one for one in numbered if one.name.isdigit() and _suffix(one)), key=lambda one: int(one.name))
    return parts or [one for one in (path / "sparse", path) if _suffix(one)][:1]


def _largest(path: Path, models: Sequence[Path]) -> Path:
    if len(models) == 1:
        return models[0]
    counts = [len(read_images(model)) for model in models]
    best = counts.index(max(counts))
    parts = ", ".join(f"sparse/{model.name} has {count}" for model, count in zip(models, counts, strict=True))
    told = f"{path}: {len(models)} models, of parts that COLMAP did not join: sparse/{models[best].name} is read"
    warnings.warn(f"{told}; images: {parts}; give the folder of another model to read it", stacklevel=4)
    return models[best]


def _read_frames(model: Path, bases: Sequence[Path]) -> Sequence[Frame]:
    images = read_images(model)
    folder = _image_folder(bases, images[0].name, str(model))
    files = [present(path_inside(folder, one.name, str(model)), f"an image of the model in {model}") for one in images]
    tell_unlisted(str(model), files)
    parts = zip(files, images, frame_names([image.name for image in images]), strict=True)
    return read_shots([image._replace(color=file, name=name) for file, image, name in parts])


def _image_folder(bases: Sequence[Path], name: str, source: str) -> Path:
    folders = [base / place for base in bases for place in _IMAGES]
    for folder in folders:
        if has_file(path_inside(folder, name, source)):
            return folder
    places = ", ".join(str(folder) for folder in folders)
    raise FileNotFoundError(f"{source}: its image {name!r} is missing; looked for it in {places}")


class _Row(NamedTuple):
    id: int
    pose: list[float]  # quaternion w x y z, translation
    camera: int
    name: str


_Point = tuple[float, ...]  # id, position, colour
T = TypeVar("T")


_PARTS = "cameras", "images", "points3D"


def _suffix(folder: Path) -> str | None:
    """The suffix of a model's files, .bin or .txt: as in COLMAP, one for all, .bin if both are whole; None: none."""
    found = {kind: [has_file(folder / f"{part}{kind}") for part in _PARTS] for kind in (".bin", ".txt")}
    return next((kind for least in (3, 2) for kind, has in found.items() if all(has[:least])), None)


def read_images(folder: Path) -> list[Shot]:
    """Returns the images of a model, sorted by name."""
    cameras_file, cameras = _read(folder, "cameras", _cameras_of_binary, _cameras_of_text)
    images_file, rows = _read(folder, "images", _images_of_binary, _images_of_text)
    if not rows:
        raise ValueError(f"{images_file}: expected images with poses, got none")
    rows.sort(key=lambda row: row.name)
    no_twice((row.name for row in rows), f"{images_file}: image")
    no_twice((row.id for row in rows), f"{images_file}: image")
    for row in rows:
        if row.camera not in cameras:
            raise ValueError(f"{images_file}: image {row.name!r} is of camera {row.camera}, which {cameras_file} lacks")
    numbers = np.array([row.pose for row in rows])
    poses = poses_from_quaternions(numbers[:, [1, 2, 3, 0]], numbers[:, 4:], str(images_file))
    return [Shot(Path(row.name), cameras[row.camera], pose, row.name) for row, pose in zip(rows, poses, strict=True)]


def read_points(folder: Path, invalid: Invalid) -> tuple[Tensor, Tensor]:
    """Returns the sparse points of a model, sorted by id: positions [N, 3] float64 and colours [N, 3] uint8."""
    file, rows = _read(folder, "points3D", _points_of_binary, _points_of_text)
    if not rows:
        raise ValueError(f"{file}: expected points, got none")
    no_twice((row[0] for row in rows), f"{file}: point")
    values = torch.tensor([row[1:] for row in sorted(rows)], dtype=torch.float64)
    values = values[kept_points(values[:, :3], str(file), invalid)]
    colors = values[:, 3:]
    if not ((colors >= 0) & (colors <= 255)).all():
        raise ValueError(f"{file}: expected colours of 0 to 255, got {colors.min():g} to {colors.max():g}")
    return values[:, :3], colors.to(torch.uint8)


def _read(folder: Path, part: str, of_binary: Callable[[Path], T], of_text: Callable[[Path], T]) -> tuple[Path, T]:
    """The file of a part of the model, and its content."""
    file = folder / f"{part}{_suffix(folder) or '.txt'}"
    return file, (of_binary if file.suffix == ".bin" else of_text)(file)


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
        told = f"{name}: expected a camera model of {', '.join(_PARAMETERS)}, got {model[:40]}"
        raise ValueError(f"{told}; `colmap image_undistorter` makes undistorted images and a model of PINHOLE cameras")
    return _PARAMETERS[model]


def _cameras_of_text(path: Path) -> dict[int, Camera]:
    cameras = []
    for name, words in fields(read_lines(path, "COLMAP's cameras"), "CAMERA_ID MODEL WIDTH HEIGHT PARAMS", 5):
        key, width, height = (parse_integer(word, name) for word in (words[0], words[2], words[3]))
        cameras.append((key, _camera(words[1], width, height, parse_numbers(words[4].split(), name), name)))
    return dict_of(cameras, f"{path}: camera")


def _images_of_text(path: Path) -> list[_Row]:
    rows = []
    lines = read_lines(path, "COLMAP's images")
    for name, words in fields(lines, "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME", 10):
        number, camera = (parse_integer(words[place], name) for place in (0, 8))
        rows.append(_Row(number, parse_numbers(words[1:8], name), camera, words[9]))
        of_points, points = next(lines, (name, ""))
        if len(points.split()) % 3:
            told = "expected 2D points X Y POINT3D_ID of the image above, or an empty line"
            raise ValueError(f"{of_points}: {told}, got {points[:80]!r}")
        parse_numbers(points.split()[-3:], of_points)  # not an image whose name has spaces
    return rows


def _points_of_text(path: Path) -> list[_Point]:
    lines = fields(read_lines(path, "COLMAP's 3D points"), "POINT3D_ID X Y Z R G B ERROR TRACK", 8)
    return [(parse_integer(words[0], name), *parse_numbers(words[1:7], name)) for name, words in lines]


def _cameras_of_binary(path: Path) -> dict[int, Camera]:
    cameras = []
    with BinaryFile(path) as file:
        for _ in range(file.count(smallest=48)):
            key, number, width, height = file.read("IiQQ")
            name = f"{path}: camera {key}"
            model = MODELS[number] if 0 <= number < len(MODELS) else f"number {number}"
            cameras.append((key, _camera(model, width, height, file.read(f"{_check_model(model, name)[1]}d"), name)))
        file.finish()
    return dict_of(cameras, f"{path}: camera")


def _images_of_binary(path: Path) -> list[_Row]:
    rows = []
    with BinaryFile(path) as file:
        for _ in range(file.count(smallest=73)):
            number, *pose, camera = file.read("I7dI")
            rows.append(_Row(number, pose, camera, file.text()))
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
