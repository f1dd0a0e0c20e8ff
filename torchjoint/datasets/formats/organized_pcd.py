"""Reads an organised PCD file, one RGB-D view, such as mOSD's table-tops (after A. Richtsfeld, IROS 2012).

NAME.pcd                 WIDTH x HEIGHT points, row by row like pixels: x, y, z in the camera's frame, rgb or rgba for
                         all pixels, and optionally label; where depth is unknown, x, y, z are NaN or z = 0

The world frame is the camera's frame; the pose is the identity. Each point lies on its pixel's ray, so the intrinsics
are found by least squares: column = fx x/z + cx and row = fy y/z + cy (mOSD: 525, 525, 319.5, 239.5). The cloud holds
the points with depth, row by row. A cloud that was moved to another frame, or that a LiDAR made, is on no camera's
rays: it is read as a cloud alone, and a warning tells so.

Ground truth from mOSD's labels: 0 is void, 1-9 are parts of the table, 20-29 of the first object, 30-39 of the second,
and so on. label // 10 merges the parts of an object, so the table is 0, the first object 2, the second 3. Pixels
without depth are void. The background is void, too: mOSD has removed it from the points, but not from the image.
"""

import warnings
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from torchjoint.datasets.files.columns import repaired
from torchjoint.datasets.files.pcd import Pcd, read_pcd, read_pcd_header
from torchjoint.datasets.formats import cloud_alone
from torchjoint.datasets.recording import Options
from torchjoint.runtime.foreign_files import has_file, or_unreadable
from torchjoint.scene import Frame, Scene, Truth
from torchjoint.scene.checks import as_labels

WHAT = "an organised .pcd (HEIGHT above 1) with x, y, z and rgb or rgba"

#: Largest reprojection error of a point, pixels; above it, the cloud is not from a pinhole camera.
LARGEST_OFFSET = 0.5


def recognizes(path: Path) -> bool:
    if path.suffix.lower() == ".pcd" and has_file(path):
        with suppress(ValueError, OSError):
            header = read_pcd_header(path)
            return header.height > 1 and not {"rgb", "rgba"}.isdisjoint(header.fields)
    return False


def scenes(path: Path) -> dict[str, Path]:
    """Returns the organised clouds of a folder."""
    return {file.stem: file for file in sorted(path.glob("*.[pP][cC][dD]")) if or_unreadable(recognizes, file)}


def load(path: Path, options: Options) -> Scene:
    cloud = read_pcd(path)
    found = cloud.cloud(str(path))
    points, colors = found.points, found.colors
    if colors is None:
        raise ValueError(f"{path}: expected a field rgb or rgba of 4 bytes")
    known = torch.isfinite(points).all(dim=1) & (points[:, 2] > 0)
    size, intrinsics = (cloud.height, cloud.width), _intrinsics(path, points, known, cloud.width)
    if intrinsics is None:
        return cloud_alone.load(path, replace(options, invalid="drop"))
    frame = Frame(
        (colors.view(*size, 3).permute(2, 0, 1) * 255).round().byte().contiguous(),
        intrinsics,
        torch.eye(4, dtype=torch.float64),
        depth=torch.where(known, points[:, 2], 0).float().view(size),
        name=path.stem,
    )
    instances = _instances(path, cloud, known)
    truth = None if instances is None else Truth(instances[known], (instances.view(size),))
    seen = repaired(found.chosen(known), str(path))
    return Scene(seen.points, (frame,), seen.colors, seen.normals, name=path.stem, truth=truth)


def _intrinsics(path: Path, points: Tensor, known: Tensor, width: int) -> Tensor | None:
    """The camera's matrix; None, with a warning, if the points are not on its rays."""
    place = torch.nonzero(known).squeeze(1)
    matrix = torch.eye(3, dtype=torch.float64)
    for axis, pixel in enumerate((place % width, place.div(width, rounding_mode="floor"))):
        slope, pixel = points[place, axis].double() / points[place, 2].double(), pixel.double()
        if len(place) < 2 or float(slope.max() - slope.min()) < 1e-6:
            told = f"{path}: {len(place)} points with depth are too few, or too close, to find intrinsics"
            if len(place) >= int((points[:, 2] < 0).sum()):
                raise ValueError(told)
            warnings.warn(f"{told}: read as a cloud alone, without an image", stacklevel=3)
            return None
        focal, center = np.polyfit(slope.numpy(), pixel.numpy(), 1)
        offset = float((focal * slope + center - pixel).abs().max())
        if not (offset <= LARGEST_OFFSET and focal > 0):
            told = f"{path}: expected points on the rays of a pinhole camera's pixels, got one {offset:.3g} px off"
            warnings.warn(f"{told} its ray: read as a cloud alone, without an image", stacklevel=3)
            return None
        matrix[axis, axis], matrix[axis, 2] = focal, center
    return matrix


def _instances(path: Path, cloud: Pcd, known: Tensor) -> Tensor | None:
    """[H W] int64 instances of all pixels; None without labels."""
    if "label" not in cloud.fields:
        return None
    values = cloud.fields["label"]
    if values.ndim != 1 or values.dtype.kind not in "iu":
        raise ValueError(f"{path}: expected one integer per point in the field label, got {values.dtype}")
    labels = torch.from_numpy(values.astype("int64"))
    return as_labels(torch.where(known & (labels != 0), labels // 10, -1), (len(labels),), f"{path}: label")
