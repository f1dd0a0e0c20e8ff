"""Undistorts images and their depth: OpenCV's perspective and fisheye lenses."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

Matrix = npt.NDArray[np.float64]
Size = tuple[int, int]  # (W, H), as in OpenCV

#: For (intrinsics, coefficients, size): the intrinsics of the undistorted image, and the column and row of each of its
#: pixels in the distorted image.
Lens = Callable[[Matrix, Matrix, Size], tuple[Matrix, npt.NDArray[Any], npt.NDArray[Any]]]


def undistort(
    image: Tensor, depth: Tensor | None, intrinsics: Tensor, distortion: tuple[float, ...], name: str = "camera"
) -> tuple[Tensor, Tensor | None, Tensor]:
    """Undistorts image and depth; crops the view to pixels that the image covers, as nerfstudio and COLMAP do.

    Args:
        image: [3, H, W] uint8.
        depth: [H, W] float32 metres, 0 = unknown; resampled by nearest neighbour.
        intrinsics: [3, 3] of the distorted image, pixels.
        distortion: as in :class:`~torchjoint.datasets.cameras.Camera`.
        name: used in messages.

    Returns:
        Image, depth and intrinsics, undistorted; the image size does not change.

    Raises:
        ValueError: the distortion model cannot be inverted in this image.
    """
    return _resample(_perspective, image, depth, intrinsics, distortion, name)


def undistort_fisheye(
    image: Tensor, depth: Tensor | None, intrinsics: Tensor, distortion: tuple[float, ...], name: str = "camera"
) -> tuple[Tensor, Tensor | None, Tensor]:
    """As :func:`undistort`, for a fisheye with k1, k2, k3, k4.

    The focal length stays, and so does the resolution in the middle. The image shows what fits into its size: of a lens
    that sees 180 degrees from edge to edge, about 115.
    """
    return _resample(_fisheye, image, depth, intrinsics, distortion, name)


def _resample(
    lens: Lens, image: Tensor, depth: Tensor | None, intrinsics: Tensor, distortion: tuple[float, ...], name: str
) -> tuple[Tensor, Tensor | None, Tensor]:
    import cv2

    size = (image.shape[2], image.shape[1])
    try:
        after, columns, rows = lens(intrinsics.numpy(), np.array(distortion, dtype=np.float64), size)
        pixels = np.ascontiguousarray(image.permute(1, 2, 0).numpy())
        straight = cv2.remap(pixels, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        straight_depth = (
            None if depth is None else cv2.remap(depth.contiguous().numpy(), columns, rows, cv2.INTER_NEAREST)
        )
    except cv2.error as error:
        raise ValueError(f"{name}: images of {size[0]} x {size[1]} pixels cannot be undistorted: {error}") from error
    except ArithmeticError as error:
        raise ValueError(
            f"{name}: distortion {distortion} cannot be undone in images of {size[0]} x {size[1]} pixels"
        ) from error
    return (
        torch.from_numpy(straight).permute(2, 0, 1),
        None if straight_depth is None else torch.from_numpy(straight_depth),
        torch.from_numpy(after),
    )


def _perspective(before: Matrix, coefficients: Matrix, size: Size) -> tuple[Matrix, npt.NDArray[Any], npt.NDArray[Any]]:
    import cv2

    after = np.asarray(cv2.getOptimalNewCameraMatrix(before, coefficients, size, 0)[0], dtype=np.float64)
    zoom = np.diag(after)[:2] / np.diag(before)[:2]
    if not (np.isfinite(after).all() and (zoom > 0.25).all() and (zoom < 4).all()):
        raise ArithmeticError
    k1, k2, _, _, k3, k4, k5, k6 = np.append(coefficients, np.zeros(8))[:8]
    radius = np.linspace(0, _largest_radius(after, size), 200)
    square = radius**2
    above, below = (1 + square * (a + square * (b + square * c)) for a, b, c in ((k1, k2, k3), (k4, k5, k6)))
    if not (below > 0).all():
        raise ArithmeticError
    _must_grow(radius * above / below)
    return after, *cv2.initUndistortRectifyMap(before, coefficients, np.eye(3), after, size, cv2.CV_32FC1)


def _fisheye(before: Matrix, coefficients: Matrix, size: Size) -> tuple[Matrix, npt.NDArray[Any], npt.NDArray[Any]]:
    import cv2

    after = before.copy()
    k1, k2, k3, k4 = np.append(coefficients, np.zeros(4))[:4]
    angle = np.arctan(np.linspace(0, _largest_radius(after, size), 200))
    square = angle**2
    _must_grow(angle * (1 + square * (k1 + square * (k2 + square * (k3 + square * k4)))))
    columns, rows = cv2.fisheye.initUndistortRectifyMap(before, coefficients, np.eye(3), after, size, cv2.CV_32FC1)
    if columns.min() < -1 or rows.min() < -1 or columns.max() > size[0] or rows.max() > size[1]:
        raise ArithmeticError  # the lens sees less at the border than a pinhole would
    return after, columns, rows


def _largest_radius(after: Matrix, size: Size) -> float:
    """Of a corner of the undistorted image, in focal lengths."""
    corners = np.array([(x, y) for x in (0, size[0]) for y in (0, size[1])])
    return float(np.linalg.norm((corners - after[:2, 2]) / np.diag(after)[:2], axis=1).max())


def _must_grow(distorted: Matrix) -> None:
    """Raises ArithmeticError unless the distorted radius grows with the radius, up to the corners."""
    if not (np.diff(distorted) > 0).all():
        raise ArithmeticError
