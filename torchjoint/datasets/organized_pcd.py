"""An organised PCD file, one view of an RGB-D camera, such as mOSD's table-tops (after A. Richtsfeld, IROS 2012).

NAME.pcd                 WIDTH x HEIGHT points in rows, as the pixels are: x, y, z in the camera's frame, rgb or rgba
                         for all pixels, and perhaps label; x, y, z NaN, or z = 0, where no depth is known

World is the camera's frame, and the pose the identity. The intrinsics are found from the points, which lie on their
pixels' rays: column = fx x/z + cx and row = fy y/z + cy, by least squares (mOSD: 525, 525, 319.5, 239.5). The cloud is
the points with depth, row after row.

Truth, of mOSD's labels: 0 is void, 1-9 are parts of the table, 20-29 of the first object, 30-39 of the second and so
on. label // 10 joins an object's parts, so that the table is 0, the first object 2, the second 3. Without depth all is
void: so is the background, which mOSD has cropped from the points, but not from the image.
"""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor

from torchjoint.datasets.pcd import Pcd, read_pcd, read_pcd_header
from torchjoint.datasets.recording import Options
from torchjoint.scene import Frame, Scene, Truth
from torchjoint.scene.checks import as_labels

WHAT = "an organised .pcd (HEIGHT above 1) with x, y, z and rgb or rgba"

#: How far from its pixel's centre a point may fall, pixels, before the cloud is not of a pinhole camera.
LARGEST_OFFSET = 0.5


def recognizes(path: Path) -> bool:
    """Whether the file's header says so."""
    if path.suffix.lower() != ".pcd" or not path.is_file():
        return False
    try:
        header = read_pcd_header(path)
    except (ValueError, OSError):
        return False
    return header.height > 1 and not {"rgb", "rgba"}.isdisjoint(header.fields)


def scenes(path: Path) -> dict[str, Path]:
    """The organised clouds of a folder."""
    return {file.stem: file for file in sorted(path.glob("*.pcd")) if recognizes(file)}


def load(path: Path, options: Options) -> Scene:
    """Loads the view; see :func:`torchjoint.load_scene`."""
    cloud = read_pcd(path)
    points, colors = cloud.points(), cloud.colors()
    if colors is None:
        raise ValueError(f"{path}: expected a field rgb or rgba of 4 bytes")
    known = torch.isfinite(points).all(dim=1) & (points[:, 2] > 0)
    size = (cloud.height, cloud.width)
    frame = Frame(
        colors.view(*size, 3).permute(2, 0, 1).contiguous(),
        _intrinsics(path, points, known, cloud.width),
        torch.eye(4, dtype=torch.float64),
        depth=torch.where(known, points[:, 2], 0).float().view(size),
        name=path.stem,
    )
    instances = _instances(path, cloud, known)
    truth = None if instances is None else Truth(instances[known], (instances.view(size),))
    return Scene(points[known], (frame,), colors[known], name=path.stem, truth=truth)


def _intrinsics(path: Path, points: Tensor, known: Tensor, width: int) -> Tensor:
    place = torch.nonzero(known).squeeze(1)
    matrix = torch.eye(3, dtype=torch.float64)
    for axis, pixel in enumerate((place % width, place.div(width, rounding_mode="floor"))):
        slope, pixel = points[place, axis] / points[place, 2], pixel.double()
        if len(place) < 2 or float(slope.max() - slope.min()) < 1e-6:
            raise ValueError(f"{path}: {len(place)} points with depth are too few, or too close, to find intrinsics")
        away = slope - slope.mean()
        focal = (away * (pixel - pixel.mean())).sum() / (away * away).sum()
        center = pixel.mean() - focal * slope.mean()
        offset = float((focal * slope + center - pixel).abs().max())
        if not (offset <= LARGEST_OFFSET and focal > 0):
            raise ValueError(
                f"{path}: expected points on the rays of a pinhole camera's pixels, got one {offset:.3g} px off its own"
            )
        matrix[axis, axis], matrix[axis, 2] = focal, center
    return matrix


def _instances(path: Path, cloud: Pcd, known: Tensor) -> Tensor | None:
    """[H W] int64 of all pixels."""
    if "label" not in cloud.fields:
        return None
    values = cloud.fields["label"]
    if values.ndim != 1 or values.dtype.kind not in "iu":
        raise ValueError(f"{path}: expected one integer a point in the field label, got {values.dtype}")
    labels = torch.from_numpy(values.astype("int64"))
    return as_labels(torch.where(known & (labels != 0), labels // 10, -1), (len(labels),), f"{path}: label")
