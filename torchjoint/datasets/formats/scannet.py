"""Reads ScanNet v2: one scan, sceneXXXX_XX, as downloaded or with exported frames.

A. Dai et al., "ScanNet: Richly-annotated 3D Reconstructions of Indoor Scenes" (CVPR 2017).

SCAN.sens                              the frames: a sensor stream, version 4; if absent, they are single files:
color/N.jpg, depth/N.png, pose/N.txt   8-bit RGB; 16-bit, millimetres; 4x4 camera-to-world, -inf = lost (left out)
intrinsic/intrinsic_{color,depth}.txt  4x4, of the exported frames; or SCAN.txt, which holds the calibrations, too
SCAN_vh_clean_2.ply                    the cloud: the mesh's vertices (fused from depth if absent)
SCAN_vh_clean_2.0.010000.segs.json,    the vertices' instances (optional)
SCAN.aggregation.json
instance-filt/N.png                    the pixels' instances, objectId + 1, 0 = none (optional; or
                                       SCAN_2d-instance-filt.zip, as downloaded)

Images keep their size, mostly 1296x968. ScanNet's authors have aligned the 640x480 depth to the same view. It is
resampled to the image by nearest neighbour with the intrinsics of both cameras. Neither the extrinsics between the
cameras nor SCAN.txt's axis alignment are applied.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchjoint.datasets import recording
from torchjoint.datasets.cameras import pinhole_matrix, register_depth, stretch_intrinsics, world_to_camera
from torchjoint.datasets.files.binary import BinaryFile
from torchjoint.datasets.files.readers import decode_image, of_size, read_depth, read_image, read_matrix, rgb_of
from torchjoint.datasets.files.text import Record, parse_numbers
from torchjoint.datasets.truth import image_instances, vertex_instances
from torchjoint.runtime import bounds
from torchjoint.runtime.foreign_files import dict_of, has_file, has_folder, inflate, open_file, or_unreadable, read_text
from torchjoint.scene import Frame, Scene
from torchjoint.scene.checks import as_intrinsics

WHAT = "SCAN.sens, or SCAN_vh_clean_2.ply, or color/, pose/ and intrinsic/, in a folder called SCAN (ScanNet)"
CLOUD = "_vh_clean_2.ply"
_SUFFIXES = (".jpg", ".jpeg", ".png")
#: Of a .sens file; and its numbers of codecs of colour, and of depth.
VERSION = 4
_PNG, _JPEG = 1, 2
_RAW, _ZLIB = 0, 1

#: Intrinsics and extrinsics of colour and depth, their codecs, their sizes, depth units per metre.
_HEADER = "64f2i4If"
#: Pose, times of colour and depth, bytes of colour and depth.
_FRAME, _FRAME_BYTES = "16f4Q", 96
#: Images of 640 x 480 pixels are those of 1296 x 968, stretched by .4 %; and those of 328 x 256, as 3D-SIS has them, by
#: 4.3 %; what is stretched more is cropped.
STRETCH = 0.05
Size = tuple[int, int]
#: An image in a .sens file: its first byte, and how many it has.
_Place = tuple[int, int]

#: (H, W) of the sensor's images in nearly all scans.
COLOR_SIZE, DEPTH_SIZE = (968, 1296), (480, 640)


def recognizes(path: Path) -> bool:
    if has_file(path):
        return path.suffix.lower() == ".sens"
    own = any(has_file(recording.without_case(path / f"{path.name}{suffix}")) for suffix in (".sens", CLOUD))
    return own or ((has_folder(path / "intrinsic") or has_file(path / f"{path.name}.txt")) and has_frames(path))


def load(path: Path, options: recording.Options) -> Scene:
    folder, scan = (path.parent, path.stem) if has_file(path) else (path, path.name)
    frames = _read_frames(folder, scan, path if has_file(path) else recording.without_case(path / f"{scan}.sens"))
    instances, images = partial(vertex_instances, folder, scan), image_instances(folder, scan, frames)
    clouds = [folder / f"{scan}{CLOUD}"]
    scene = recording.scene_of_frames(folder, frames, options, clouds, instances=instances, images=images)
    return replace(scene, name=scan)


def scenes(path: Path) -> dict[str, Path]:
    """Returns the scans of the data set's own folder, which holds them in `scans/` and `scans_test/`."""
    folders = [one for name in ("scans", "scans_test") if has_folder(path / name) for one in (path / name).iterdir()]
    folders = [one for one in sorted(folders) if or_unreadable(has_folder, one)]
    return {one.name: one for one in folders if or_unreadable(recognizes, one)}


def _read_frames(folder: Path, scan: str, file: Path) -> recording.Frames:
    if has_file(file):
        stream = SensFile(file)
        cameras = SceneCameras(
            Calibration(stream.color_intrinsics, (stream.color_size,)),
            Calibration(stream.depth_intrinsics, (stream.depth_size,)),
        )
        poses = [(f"{stream.path}, pose of frame {i}", pose) for i, pose in enumerate(stream.poses)]
        names = [str(i) for i in range(len(stream.poses))]
        return _frames(stream.path, names, poses, cameras, lambda i: (stream.color(i), stream.depth(i)), lambda _: True)
    if not has_frames(folder):
        if has_folder(folder / "color"):
            raise FileNotFoundError(f"{folder / 'pose'}: missing; expected the poses of the images in color/")
        return recording.read_shots(())
    found = find_cameras(folder, folder / f"{scan}.txt")
    if found is None:
        raise FileNotFoundError(f"{folder}/intrinsic/intrinsic_color.txt: missing, and {scan}.txt has no calibration")
    return read_frames(folder, found)


def has_frames(folder: Path) -> bool:
    """Returns whether the folder has images and poses of this layout."""
    return has_folder(folder / "color") and has_folder(folder / "pose")


def read_frames(folder: Path, cameras: SceneCameras) -> recording.Frames:
    """Returns the frames with valid poses, sorted by number; each frame is read on access.

    Poses are camera-to-world, OpenCV axes, metres. Where tracking was lost, poses hold -inf; these frames are left out.
    Depth is in millimetres and is registered to the colour image by nearest neighbour.

    Args:
        folder: holds color/, pose/ and (optional) depth/.
        cameras: colour and depth cameras.
    """
    files = (file for file in (folder / "color").iterdir() if file.suffix.lower() in _SUFFIXES)
    images = recording.sorted_images(folder / "color", files)
    return frames_of(folder, images, cameras, (folder / "pose", folder / "depth"))


def frames_of(
    folder: Path, images: Sequence[Path], cameras: SceneCameras, beside: tuple[Path, Path]
) -> recording.Frames:
    """Returns the frames with valid poses, in the order of `images`; poses and depth are in the folders `beside`."""
    names = [file.stem for file in images]
    recording.tell_lost(str(folder), (file.stem for file in beside[0].glob("*.txt") if file.stem.isdigit()), names)
    files, depths = [beside[0] / f"{name}.txt" for name in names], [beside[1] / f"{name}.png" for name in names]

    def read(index: int) -> tuple[Tensor, Tensor | None]:
        color, depth = images[index], depths[index]
        image = of_size(read_image(color), color, images[0])
        return image, of_size(read_depth(depth), depth, next(filter(has_file, depths))) if has_file(depth) else None

    poses = [(str(file), read_matrix(file, (4, 4))) for file in files]
    return _frames(folder, names, poses, cameras, read, lambda index: has_file(depths[index]))


def _frames(
    source: Path,
    names: Sequence[str],
    poses: Sequence[tuple[str, Tensor]],
    cameras: SceneCameras,
    read: Callable[[int], tuple[Tensor, Tensor | None]],
    has_depth: Callable[[int], bool],
) -> recording.Frames:
    """The frames with finite poses; each pose has its name for messages; `read` gives colours and depth of a frame."""
    kept = [i for i, (_, pose) in enumerate(poses) if torch.isfinite(pose).all()]
    recording.tell_left_out(str(source), len(poses) - len(kept), len(poses))
    extrinsics = {i: world_to_camera(poses[i][1], poses[i][0]) for i in kept}

    def frame(place: int) -> Frame:
        i = kept[place]
        (image, depth), what = read(i), f"{source}, image of frame {names[i]}"
        size = (image.shape[1], image.shape[2])
        intrinsics = cameras.color.scaled_to(size, what)
        if depth is not None:
            # One calibration for both applies to the size that was chosen for the colour image.
            of_depth = Calibration(intrinsics, (size,)) if cameras.depth is cameras.color else cameras.depth
            depth_intrinsics = of_depth.scaled_to((depth.shape[0], depth.shape[1]), f"{what}, its depth")
            depth = register_depth(depth, depth_intrinsics, intrinsics, size)
        return Frame(image, intrinsics, extrinsics[i], depth=depth, name=names[i])

    return recording.Frames(len(kept), frame, [names[i] for i in kept], lambda place: has_depth(kept[place]))


@dataclass(frozen=True)
class Calibration:
    """Intrinsics [3, 3], pixel centres at integer coordinates, and the image size (H, W) to which they apply.

    If `is_certain` is False, the size is chosen from `sizes` and the size of the actual images: the size
    whose centre is nearest to the principal point.
    """

    intrinsics: Tensor
    sizes: tuple[Size, ...]
    is_certain: bool = True

    def scaled_to(self, size: Size, name: str = "image") -> Tensor:
        """Returns the intrinsics [3, 3] float64 of images that were resized to (H, W), each axis independently.

        ValueError, which begins with `name`, if they were cropped.
        """
        old = min(self.sizes if self.is_certain else (size, *self.sizes), key=self._off_center)
        (h, w), (height, width) = old, size
        if abs(height * w - width * h) > max(STRETCH * width * h, w, h):
            got = f"{width} x {height}: is it cropped?"
            raise ValueError(f"{name}: expected the aspect ratio of its camera, {w} x {h} pixels, got {got}")
        return stretch_intrinsics(self.intrinsics, old, size)

    def _off_center(self, size: Size) -> float:
        x, y = self.intrinsics[:2, 2].tolist()
        return abs((x + 0.5) / size[1] - 0.5) + abs((y + 0.5) / size[0] - 0.5)


class SceneCameras(NamedTuple):
    """Calibrations of the colour and the depth images."""

    color: Calibration
    depth: Calibration


def find_cameras(folder: Path, info: Path) -> SceneCameras | None:
    """Finds the cameras of a folder of exported frames; None if no file has a calibration.

    Args:
        folder: may hold intrinsic/intrinsic_color.txt and intrinsic/intrinsic_depth.txt, 4x4, as ScanNet's exporter
            writes them. Without the second file, the first is also used for depth, because ScanNet's depth is warped to
            the colour camera's view. They apply either to the sensor's resolution, which the files do not give, or to
            the images, if the calibration was scaled with them.
        info: ScanNet's SCAN.txt, which gives the sensor's calibration and resolution, but less exactly.
    """
    color = folder / "intrinsic" / "intrinsic_color.txt"
    if has_file(color):
        return read_cameras(color, color.with_name("intrinsic_depth.txt"))
    return _read_info(info) if has_file(info) else None


def read_cameras(color: Path, depth: Path) -> SceneCameras:
    """Reads the calibrations of colour and of depth; if the latter is not there, that of colour holds for both."""
    of_color = _read_calibration(color)
    return SceneCameras(of_color, _read_calibration(depth) if has_file(depth) else of_color)


def _read_calibration(file: Path) -> Calibration:
    """Reads a file of 4x4 or 3x3 numbers."""
    side = 3 if len(read_text(file, "a description", errors="replace").replace(",", " ").split()) == 9 else 4
    matrix = as_intrinsics(read_matrix(file, (side, side))[:3, :3], str(file))
    return Calibration(matrix, (COLOR_SIZE, DEPTH_SIZE), is_certain=False)


def _read_info(path: Path) -> SceneCameras | None:
    """Reads lines such as "fx_color = 1170.187988"; None if the file has no calibration.

    Depth images are warped to the colour camera's view, so the scaled colour calibration holds for depth, too.
    The file's fx_depth does not: it describes the sensor before warping (https://github.com/ScanNet/ScanNet/issues/92).
    """
    lines = [line.partition("=") for line in read_text(path, "a description of a scan").splitlines()]
    pairs = [(name.strip(), value.strip()) for name, _, value in lines if value]
    values = Record(dict_of(pairs, f"{path}: line"), str(path))
    if "fx_color" not in values:
        return None
    names = ("fx_color", "fy_color", "mx_color", "my_color", "colorHeight", "colorWidth")
    fx, fy, cx, cy, height, width = parse_numbers([values.text(name) for name in names], str(path))
    if not (1 <= height <= 2**16 and 1 <= width <= 2**16):
        raise ValueError(f"{path}: expected an image size in pixels, got colorWidth {width:g}, colorHeight {height:g}")
    both = Calibration(as_intrinsics(pinhole_matrix(fx, fy, cx, cy), f"{path}, colour"), ((int(height), int(width)),))
    return SceneCameras(both, both)


class SensFile:
    """A `.sens` file. Opening reads the file header and all frame headers; images are decoded on access.

    Attributes:
        color_intrinsics: [3, 3] float64, for images of `color_size`; pixel centres at integer coordinates.
        depth_intrinsics: [3, 3] float64, for images of `depth_size`.
        color_size: (H, W).
        depth_size: (H, W).
        poses: [F, 4, 4] float64, camera-to-world, OpenCV axes, metres; -inf where tracking was lost.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with BinaryFile(path) as file:
            self._read_header(file)
            self._images, poses = _index(file)
        self.poses = torch.from_numpy(np.array(poses, dtype=np.float64).reshape(-1, 4, 4))

    def color(self, index: int) -> Tensor:
        """Decodes a frame's colours, [3, H, W] uint8 RGB, at the image's own size. ValueError if damaged."""
        name = f"{self.path}, colour of frame {index}"
        return rgb_of(decode_image(self._read(self._images[index][0], name), name), name)

    def depth(self, index: int) -> Tensor:
        """Decodes a frame's depth, [h, w] float32 metres, 0 = unknown, of `depth_size`. ValueError if damaged."""
        name = f"{self.path}, depth of frame {index}"
        data = self._read(self._images[index][1], name)
        expected = 2 * math.prod(self.depth_size)
        if self._depth_codec == _ZLIB:
            data = inflate(data, expected, name)
        if len(data) != expected:
            raise ValueError(f"{name}: expected {expected} bytes, got {len(data)}")
        raw = np.frombuffer(data, dtype="<u2").reshape(self.depth_size)
        return torch.from_numpy(np.where(raw == 65535, 0, raw).astype(np.float32) / np.float32(self._depth_shift))

    def _read_header(self, file: BinaryFile) -> None:
        if (version := file.read("I")[0]) != VERSION:
            raise ValueError(f"{self.path}: expected a .sens file of version {VERSION}, got version {version}")
        file.skip(*file.read("Q"))  # its name
        *cameras, color_codec, depth_codec, cw, ch, dw, dh, shift = file.read(_HEADER)
        matrices = torch.tensor(cameras, dtype=torch.float64).reshape(4, 4, 4)
        self.color_intrinsics = as_intrinsics(matrices[0, :3, :3], f"{self.path}, colour's intrinsics")
        self.depth_intrinsics = as_intrinsics(matrices[2, :3, :3], f"{self.path}, depth's intrinsics")
        self.color_size, self.depth_size = (ch, cw), (dh, dw)
        self._depth_codec, self._depth_shift = depth_codec, shift
        if color_codec not in (_PNG, _JPEG) or depth_codec not in (_RAW, _ZLIB):
            told = f"{self.path}: expected colour as PNG or JPEG (1, 2) and depth raw or by zlib (0, 1)"
            raise ValueError(f"{told}, got codecs {color_codec} and {depth_codec}")
        if not all(0 < h * w <= bounds.PIXELS for h, w in (self.color_size, self.depth_size)):
            raise ValueError(f"{self.path}: impossible image sizes {cw} x {ch}, {dw} x {dh}")
        if not (math.isfinite(shift) and shift > 0):
            raise ValueError(f"{self.path}: expected a positive number of depth units per metre, got {shift}")

    def _read(self, place: _Place, name: str) -> bytes:
        with open_file(self.path) as stream:
            stream.seek(place[0])
            data = stream.read(place[1])
        if len(data) != place[1]:
            raise ValueError(f"{name}: the file has become shorter since it was opened")
        return data


def _index(file: BinaryFile) -> tuple[list[tuple[_Place, _Place]], list[list[float]]]:
    """Where the colours and the depth of each frame are, and the poses of the frames."""
    images, poses = [], []
    for _ in range(file.count(_FRAME_BYTES)):
        *pose, _, _, color_bytes, depth_bytes = file.read(_FRAME)
        images.append(((file.place, color_bytes), (file.place + color_bytes, depth_bytes)))
        poses.append(pose)
        file.skip(color_bytes + depth_bytes)
    return images, poses
