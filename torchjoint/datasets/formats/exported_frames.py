"""Reads posed frames that ScanNet's tools exported, one file each: color/N.jpg, depth/N.png, pose/N.txt."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor

from torchjoint.datasets.files.readers import read_depth, read_image, read_matrix
from torchjoint.datasets.recording import invert_pose
from torchjoint.datasets.resampling import register_depth
from torchjoint.datasets.scannet_cameras import Calibration, Cameras
from torchjoint.datasets.shots import tell_left_out
from torchjoint.runtime.foreign_files import has_file, has_folder
from torchjoint.runtime.threads import LazySequence
from torchjoint.scene import Frame
from torchjoint.scene.checks import as_pose

_SUFFIXES = (".jpg", ".jpeg", ".png")


def has_frames(folder: Path) -> bool:
    """Returns whether the folder has images and poses of this layout."""
    return has_folder(folder / "color") and has_folder(folder / "pose")


def read_frames(folder: Path, cameras: Cameras) -> LazySequence[Frame]:
    """Returns the frames with valid poses, sorted by number; each frame is read on access.

    Poses are camera-to-world, OpenCV axes, metres. Where tracking was lost, poses hold -inf; these frames are left out.
    Depth is in millimetres and is registered to the colour image by nearest neighbour.

    Args:
        folder: holds color/, pose/ and (optional) depth/.
        cameras: colour and depth cameras.

    Raises:
        FileNotFoundError: an image without a pose.
        ValueError: a pose that is not rigid, or two images with one number.
    """
    images = sorted(
        (file for file in (folder / "color").iterdir() if file.suffix.lower() in _SUFFIXES),
        key=lambda file: _order(file.stem),
    )
    stems = [file.stem for file in images]
    if len(set(stems)) < len(stems):
        twice = next(stem for stem in stems if stems.count(stem) > 1)
        raise ValueError(f"{folder / 'color'}: frame {twice!r} has two colour images")
    poses = [read_matrix(folder / "pose" / f"{stem}.txt", (4, 4)) for stem in stems]
    kept = [i for i, pose in enumerate(poses) if torch.isfinite(pose).all()]
    tell_left_out(str(folder), len(images) - len(kept), len(images))
    extrinsics = {i: invert_pose(as_pose(poses[i], str(folder / "pose" / f"{stems[i]}.txt"))) for i in kept}

    def read(place: int) -> Frame:
        i = kept[place]
        image, depth = read_image(images[i]), folder / "depth" / f"{stems[i]}.png"
        return make_frame(stems[i], image, read_depth(depth) if has_file(depth) else None, cameras, extrinsics[i])

    return LazySequence(len(kept), read, [stems[i] for i in kept])


def make_frame(name: str, image: Tensor, depth: Tensor | None, cameras: Cameras, world_to_camera: Tensor) -> Frame:
    """Makes a frame from a colour image [3, H, W] and a depth image [h, w], metres, of two cameras at one place."""
    size = (image.shape[1], image.shape[2])
    intrinsics = cameras.color.scaled_to(size)
    if depth is not None:
        # One calibration for both applies to the size that was chosen for the colour image.
        of_depth = Calibration(intrinsics, (size,)) if cameras.depth is cameras.color else cameras.depth
        depth_intrinsics = of_depth.scaled_to((depth.shape[0], depth.shape[1]))
        depth = register_depth(depth, depth_intrinsics, intrinsics, size)
    return Frame(image, intrinsics, world_to_camera, depth=depth, name=name)


def _order(stem: str) -> tuple[int, str]:
    """Sort key: by number, 2 before 10."""
    return (int(stem) if stem.isascii() and stem.isdigit() else -1, stem)
