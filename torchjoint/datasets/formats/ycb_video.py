"""Reads a sequence of YCB-Video, data/NNNN (Y. Xiang et al., "PoseCNN", RSS 2018).

NNNNNN-color.jpg (or .png)   8-bit RGB
NNNNNN-depth.png             16-bit, in 1 / factor_depth metres
NNNNNN-label.png             the object of each pixel, 0 = none (optional; all frames or none)
NNNNNN-meta.mat              intrinsic_matrix 3x3, factor_depth, rotation_translation_matrix 3x4: camera-to-world

An object occurs once in a sequence, so its number is its instance. The rest of the scene is not annotated: it is void.
The cloud is `cloud.ply`, or fused from depth.
"""

from pathlib import Path

import numpy as np
import torch

from torchjoint.datasets.cameras import Camera, world_to_camera
from torchjoint.datasets.files.mat_files import read_matrices
from torchjoint.datasets.recording import Options, Shot, read_shots, scene_of_frames, tell_lost
from torchjoint.datasets.truth import label_images
from torchjoint.runtime.foreign_files import has_file, has_folder
from torchjoint.scene import Scene

WHAT = "NNNNNN-color.jpg (or .png) with NNNNNN-meta.mat (YCB-Video)"
#: Matrices with more elements, such as vertmap, are not read: they are not needed.
MAX_ELEMENTS = 4_000_000


def recognizes(path: Path) -> bool:
    return has_folder(path) and any(has_file(_beside(file, "meta.mat")) for file in _colors(path))


def load(path: Path, options: Options) -> Scene:
    colors = _colors(path)
    tell_lost(str(path), map(_name, path.glob("[!.]*-meta.mat")), [_name(file) for file in colors])
    images = label_images([_beside(file, "label.png") for file in colors], "labels", colors)
    return scene_of_frames(path, read_shots([_shot(file) for file in colors]), options, images=images)


def _shot(file: Path) -> Shot:
    path = _beside(file, "meta.mat")
    matrices = read_matrices(path, MAX_ELEMENTS)
    shapes = {"intrinsic_matrix": (3, 3), "rotation_translation_matrix": (3, 4), "factor_depth": (1, 1)}
    for name, shape in shapes.items():
        if name not in matrices or matrices[name].shape != shape:
            came = "none" if name not in matrices else f"one of {list(matrices[name].shape)}"
            raise ValueError(f"{path}: {name}: expected a matrix of {list(shape)}, got {came}")
    intrinsics, moved, factor = (torch.from_numpy(matrices[name].astype(np.float64)) for name in shapes)
    if not (torch.isfinite(factor).all() and float(factor) > 0):
        raise ValueError(f"{path}: factor_depth: expected a number above 0, got {float(factor)}")
    pose = world_to_camera(moved, f"{path}: rotation_translation_matrix")
    camera = Camera(intrinsics, name=f"{path}: intrinsic_matrix")
    return Shot(file, camera, pose, _name(file), _beside(file, "depth.png"), 1 / float(factor))


def _colors(path: Path) -> list[Path]:
    # Of one sequence: 0048-000001 and 0049-000001 have different worlds.
    return sorted(file for file in path.glob("*-color.[jp][pn]g") if _name(file).isdecimal())


def _name(file: Path) -> str:
    return file.name.rpartition("-")[0]


def _beside(file: Path, kind: str) -> Path:
    return file.with_name(f"{_name(file)}-{kind}")
