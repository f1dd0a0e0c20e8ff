"""Reads what the demo of VGGT writes (J. Wang et al., CVPR 2025): cameras and depth that a network made of images.

predictions.npz, of S images of one size:
    images      [S, 3, H, W] RGB in [0, 1]
    extrinsic   [S, 3, 4] world-to-camera, OpenCV axes
    intrinsic   [S, 3, 3] pixels
    depth       [S, H, W, 1], without a unit
    depth_conf  [S, H, W], the confidence in it
images/         beside it, optional: the names of the frames

The network knows no metres. All lengths are multiplied by one number, so that the median depth is DISTANCE.
"""

import logging
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from torchjoint.datasets.cameras import checked_pose
from torchjoint.datasets.recording import Options, scene_of_frames
from torchjoint.runtime.archives import read_archive
from torchjoint.runtime.foreign_files import has_file, has_folder
from torchjoint.runtime.threads import LazySequence
from torchjoint.scene import Frame, Scene
from torchjoint.scene.checks import as_float, as_intrinsics, as_tensor

logger = logging.getLogger(__name__)

FILE = "predictions.npz"
WHAT = f"{FILE}, which the demo of VGGT writes"
#: The arrays that are read, with their shapes.
_SHAPES = {
    "images": "S 3 H W", "extrinsic": "S 3 4", "intrinsic": "S 3 3", "depth": "S H W 1", "depth_conf": "S H W"
}  # fmt: skip
#: Metres, the median depth.
DISTANCE = 2.0
#: This share of the pixels of all images is left out: those whose depth has the least confidence, as in VGGT's viewer.
UNSURE = 0.25


def recognizes(path: Path) -> bool:
    return has_file(path / FILE) if has_folder(path) else path.name == FILE and has_file(path)


def load(path: Path, options: Options) -> Scene:
    file = path if path.name == FILE and has_file(path) else path / FILE
    arrays = _read(file)
    depth = arrays["depth"][..., 0].astype(np.float32)
    sure = arrays["depth_conf"] >= np.nanquantile(arrays["depth_conf"], UNSURE)
    depth = np.where(sure & np.isfinite(depth) & (depth > 0), depth, 0)
    if not depth.any():
        raise ValueError(f"{file}: depth: expected numbers > 0, got none")
    scale = DISTANCE / float(np.median(depth[depth > 0]))
    logger.warning("%s: has no metres; its lengths times %.4g, so that the median depth is %g m", file, scale, DISTANCE)
    names = _names(file.parent / "images", len(depth))
    exact = {name: as_tensor(arrays[name], f"{file}: {name}") for name in ("intrinsic", "extrinsic")}
    cameras, poses = (as_float(one, f"{file}: {name}", torch.float64) for name, one in exact.items())
    poses[..., 3] *= scale

    def frame(index: int) -> Frame:
        return Frame(
            torch.from_numpy(arrays["images"][index].astype(np.float32)),
            as_intrinsics(cameras[index], f"{file}: intrinsic {index}"),
            checked_pose(poses[index], f"{file}: extrinsic {index}"),
            depth=torch.from_numpy(depth[index] * np.float32(scale)),
            name=names[index],
        )

    return scene_of_frames(file.parent, LazySequence(len(depth), frame, names), options)


def _read(file: Path) -> dict[str, NDArray[np.floating]]:
    arrays = read_archive(file, _SHAPES)
    sizes: dict[str, int] = {}
    for name, shape in _SHAPES.items():
        if name not in arrays:
            raise ValueError(f"{file}: expected an array {name!r}, [{shape}], got none")
        array, sides = arrays[name], shape.split()
        fits = array.ndim == len(sides) and array.size > 0 and np.issubdtype(array.dtype, np.floating)
        for side, length in zip(sides, array.shape, strict=False):
            fits &= length == (int(side) if side.isdecimal() else sizes.setdefault(side, length))
        if not fits:
            known = ", ".join(f"{side} = {length}" for side, length in sizes.items())
            raise ValueError(f"{file}: {name}: expected [{shape}] floats ({known}), got {array.dtype} {array.shape}")
    return arrays


def _names(folder: Path, count: int) -> list[str]:
    """The names of the images, in the order of the demo, if they are there and as many as expected; else numbers."""
    files = sorted(one.name for one in folder.iterdir() if has_file(one)) if has_folder(folder) else []
    found = [Path(name).stem for name in files if not name.startswith(".")]
    return found if len(found) == len(set(found)) == count else [f"frame-{index:06d}" for index in range(count)]
