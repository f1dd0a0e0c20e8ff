"""The two cameras of a ScanNet scan, colour and depth, from whichever file tells of them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint.datasets.files import read_matrix
from torchjoint.scene_checks import as_intrinsics

Size = tuple[int, int]

#: (H, W) of the sensors' images in nearly all scans.
COLOR_SIZE, DEPTH_SIZE = (968, 1296), (480, 640)


@dataclass(frozen=True)
class Camera:
    """Intrinsics [3, 3], pixel centres at integer coordinates, and the image size (H, W) that they are for.

    Where the size is not known it is one of `sizes`, or that of the images themselves: the one whose centre the
    principal point is nearest to.
    """

    intrinsics: Tensor
    sizes: tuple[Size, ...]
    is_certain: bool = True

    def scaled_to(self, size: Size) -> Tensor:
        """The intrinsics [3, 3] float64 of images that were resized to (H, W), each axis by itself."""
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
    """Of colour and of depth."""

    color: Camera
    depth: Camera


_NOMINAL = torch.tensor([[577.870605, 0, 319.5], [0, 577.870605, 239.5], [0, 0, 1]], dtype=torch.float64)

#: What 3D-SIS takes for every scan: the depth camera's calibration of one sensor.
NOMINAL = Cameras(Camera(_NOMINAL, (DEPTH_SIZE,)), Camera(_NOMINAL, (DEPTH_SIZE,)))


def find_cameras(folder: Path, info: Path) -> Cameras | None:
    """The cameras of a folder of exported frames; None where nothing tells of them.

    Args:
        folder: may hold intrinsic/intrinsic_color.txt and intrinsic/intrinsic_depth.txt, 4x4, as ScanNet's exporter
            writes them: of the sensor's resolution, which is not said, or of the images, if they were scaled, too.
        info: ScanNet's SCAN.txt, which tells both calibrations and resolutions.

    Raises:
        FileNotFoundError, ValueError: naming the file and what is wrong with it.
    """
    color = folder / "intrinsic" / "intrinsic_color.txt"
    if color.is_file():
        depth = color.with_name("intrinsic_depth.txt")
        matrices = [as_intrinsics(read_matrix(file, (4, 4))[:3, :3], str(file)) for file in (color, depth)]
        return Cameras(*(Camera(matrix, (COLOR_SIZE, DEPTH_SIZE), is_certain=False) for matrix in matrices))
    return _read_info(info) if info.is_file() else None


def _read_info(path: Path) -> Cameras | None:
    """Of lines such as "fx_color = 1170.187988"; None where there are no calibrations among them."""
    try:
        lines = [line.partition("=") for line in path.read_text(encoding="utf-8").splitlines()]
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: expected lines of text, got {error}") from error
    values = {name.strip(): value.strip() for name, _, value in lines}
    if "fx_color" not in values:
        return None
    return Cameras(_camera(values, "color", path), _camera(values, "depth", path))


def _camera(values: dict[str, str], which: str, path: Path) -> Camera:
    names = [f"{name}_{which}" for name in ("fx", "fy", "mx", "my")] + [f"{which}Height", f"{which}Width"]
    try:
        fx, fy, cx, cy, height, width = (float(values[name]) for name in names)
    except KeyError as error:
        raise ValueError(
            f"{path}: expected a line {error.args[0]} = ..., as others of the calibration are there"
        ) from None
    except ValueError as error:
        raise ValueError(f"{path}: expected numbers, got {error}") from error
    matrix = torch.tensor([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], dtype=torch.float64)
    if not (1 <= height <= 2**16 and 1 <= width <= 2**16):
        raise ValueError(
            f"{path}: expected an image size in pixels, got {which}Width {width:g}, {which}Height {height:g}"
        )
    return Camera(as_intrinsics(matrix, f"{path}, {which}"), ((int(height), int(width)),))
