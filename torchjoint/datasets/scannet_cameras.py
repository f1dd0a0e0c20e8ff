"""The intrinsics of a ScanNet scan's colour and depth images (both have the same view), from any file that has them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint.datasets.files.readers import read_matrix
from torchjoint.runtime.foreign_files import dict_of, has_file, read_text
from torchjoint.scene.checks import as_intrinsics

Size = tuple[int, int]

#: (H, W) of the sensor's images in nearly all scans.
COLOR_SIZE, DEPTH_SIZE = (968, 1296), (480, 640)


@dataclass(frozen=True)
class Calibration:
    """Intrinsics [3, 3], pixel centres at integer coordinates, and the image size (H, W) to which they apply.

    If `is_certain` is False, the size is chosen from `sizes` and the size of the actual images: the size
    whose centre is nearest to the principal point.
    """

    intrinsics: Tensor
    sizes: tuple[Size, ...]
    is_certain: bool = True

    def scaled_to(self, size: Size) -> Tensor:
        """Returns the intrinsics [3, 3] float64 of images that were resized to (H, W), each axis independently."""
        known = self.sizes if self.is_certain else (size, *self.sizes)
        old = min(known, key=self._off_center)
        scale = torch.tensor([size[1] / old[1], size[0] / old[0]], dtype=torch.float64)
        scaled = self.intrinsics.clone()
        scaled[:2] *= scale[:, None]
        scaled[:2, 2] += (scale - 1) / 2  # an image's corner is at -1/2 before and after
        return scaled

    def _off_center(self, size: Size) -> float:
        x, y = self.intrinsics[:2, 2].tolist()
        return abs((x + 0.5) / size[1] - 0.5) + abs((y + 0.5) / size[0] - 0.5)


class Cameras(NamedTuple):
    """Calibrations of the colour and the depth images."""

    color: Calibration
    depth: Calibration


def find_cameras(folder: Path, info: Path) -> Cameras | None:
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
        depth = color.with_name("intrinsic_depth.txt")
        of_color = read_calibration(color)
        return Cameras(of_color, read_calibration(depth) if has_file(depth) else of_color)
    return _read_info(info) if has_file(info) else None


def read_calibration(file: Path) -> Calibration:
    """Reads a file of 4x4 or 3x3 numbers."""
    side = 3 if len(read_text(file, "a description", errors="replace").replace(",", " ").split()) == 9 else 4
    matrix = as_intrinsics(read_matrix(file, (side, side))[:3, :3], str(file))
    return Calibration(matrix, (COLOR_SIZE, DEPTH_SIZE), is_certain=False)


def _read_info(path: Path) -> Cameras | None:
    """Reads lines such as "fx_color = 1170.187988"; None if the file has no calibration.

    Depth images are warped to the colour camera's view, so the scaled colour calibration holds for depth, too.
    The file's fx_depth does not: it describes the sensor before warping (https://github.com/ScanNet/ScanNet/issues/92).
    """
    try:
        lines = [line.partition("=") for line in read_text(path, "a description of a scan").splitlines()]
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: expected lines of text, got {error}") from error
    values = dict_of([(name.strip(), value.strip()) for name, _, value in lines if value], f"{path}: line")
    if "fx_color" not in values:
        return None
    names = ("fx_color", "fy_color", "mx_color", "my_color", "colorHeight", "colorWidth")
    try:
        fx, fy, cx, cy, height, width = (float(values[name]) for name in names)
    except KeyError as error:
        raise ValueError(f"{path}: expected a line {error.args[0]} = ..., as there is one of fx_color") from None
    except ValueError as error:
        raise ValueError(f"{path}: expected numbers, got {error}") from error
    if not (1 <= height <= 2**16 and 1 <= width <= 2**16):
        raise ValueError(f"{path}: expected an image size in pixels, got colorWidth {width:g}, colorHeight {height:g}")
    matrix = torch.tensor([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], dtype=torch.float64)
    both = Calibration(as_intrinsics(matrix, f"{path}, colour"), ((int(height), int(width)),))
    return Cameras(both, both)
