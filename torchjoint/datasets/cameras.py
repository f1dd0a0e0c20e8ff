"""Converts cameras of other conventions: quaternions, OpenGL axes, resized images, distorting lenses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchjoint.datasets.lenses import undistort, undistort_fisheye
from torchjoint.datasets.resampling import resize_nearest
from torchjoint.scene import Frame
from torchjoint.scene.checks import as_intrinsics

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

Matrix = npt.NDArray[np.float64]

#: From OpenGL's camera axes (x right, y up, z back) to OpenCV's; this matrix is its own inverse.
FLIP_YZ = torch.diag(torch.tensor([1.0, -1.0, -1.0, 1.0], dtype=torch.float64))

#: Largest difference between a quaternion's length and 1: files give at least two digits.
UNIT_TOLERANCE = 0.02


@dataclass(frozen=True, eq=False)
class Camera:
    """A camera with OpenCV's lens distortion.

    Args:
        intrinsics: [3, 3] float64, pixels; pixel centres have integer coordinates.
        size: (H, W) of the images for which the camera was calibrated; None: images of any size.
        distortion: k1, k2, p1, p2; or also k3; or also k3, k4, k5, k6, as for ``cv2.undistort``; empty = none. Of a
            fisheye: k1, k2, k3, k4, as for ``cv2.fisheye``.
        name: used in messages.
        fisheye: the lens is a fisheye: without distortion, the radius in the image grows with the angle.

    Raises:
        ValueError: numbers that are not finite; a focal length or size that is not positive.
    """

    intrinsics: Tensor
    size: tuple[int, int] | None = None
    distortion: tuple[float, ...] = ()
    name: str = "camera"
    fisheye: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "intrinsics", as_intrinsics(self.intrinsics, f"intrinsics of {self.name}"))
        if self.size is not None and min(self.size) < 1:
            raise ValueError(f"{self.name}: expected images of at least one pixel, got {self.size[1]} x {self.size[0]}")
        if not np.isfinite(self.distortion).all():
            raise ValueError(f"{self.name}: expected finite distortion coefficients, got {self.distortion}")

    def frame(self, image: Tensor, world_to_camera: Tensor, depth: Tensor | None = None, name: str = "") -> Frame:
        """Makes a frame from an image of this camera: scales the intrinsics to its size, undistorts image and depth.

        Args:
            image: [3, H, W] uint8.
            world_to_camera: [4, 4].
            depth: [h, w] float32 metres, of the same view at any resolution; 0 = unknown.
            name: of the frame.

        Raises:
            ValueError: image or depth has another aspect ratio than the camera, or the distortion cannot be
                inverted.
        """
        size = (image.shape[1], image.shape[2])
        called = f"image {name!r} of {self.name}"
        intrinsics = (
            self.intrinsics if self.size is None else scale_intrinsics(self.intrinsics, self.size, size, called)
        )
        if depth is not None:
            depth = resize_depth(depth, size, name)
        if self.fisheye:
            image, depth, intrinsics = undistort_fisheye(image, depth, intrinsics, self.distortion, self.name)
        elif any(self.distortion):
            image, depth, intrinsics = undistort(image, depth, intrinsics, self.distortion, self.name)
        return Frame(image, intrinsics, world_to_camera, depth=depth, name=name)


def pinhole_matrix(fx: float, fy: float, cx: float, cy: float, *, center: float = 0.0) -> Tensor:
    """Returns a camera matrix [3, 3] float64. In cx and cy the first pixel's centre is at `center`, 0 or 1/2."""
    return torch.tensor([[fx, 0, cx - center], [0, fy, cy - center], [0, 0, 1]], dtype=torch.float64)


def scale_intrinsics(intrinsics: Tensor, old: tuple[int, int], new: tuple[int, int], name: str = "image") -> Tensor:
    """Returns intrinsics [3, 3] for images that were resized from (H, W) `old` to `new`.

    Resizing maps image corners to image corners; with integer pixel centres the corners are at -1/2 and W - 1/2.

    Raises:
        ValueError: the aspect ratios differ by more than rounding to whole pixels explains.
    """
    _check_same_shape(old, new, name)
    scale = torch.tensor([new[1] / old[1], new[0] / old[0], 1.0], dtype=torch.float64)
    scaled = intrinsics * scale[:, None]
    scaled[:2, 2] += (scale[:2] - 1) / 2
    return scaled


def resize_depth(depth: Tensor, size: tuple[int, int], name: str = "") -> Tensor:
    """Resizes depth [h, w] to (H, W) by nearest neighbour: depth must not be averaged over edges."""
    if depth.ndim != 2 or 0 in depth.shape:
        raise ValueError(f"depth of frame {name!r}: expected shape [H, W], got {list(depth.shape)}")
    _check_same_shape((depth.shape[0], depth.shape[1]), size, f"depth of frame {name!r}")
    return resize_nearest(depth, size)


def rotations_from_quaternions(quaternions: Matrix, name: str) -> Rotation:
    """Converts unit quaternions [N, 4], x y z w (Hamilton convention), to N rotations.

    Raises:
        ValueError: a quaternion's length is not 1.
    """
    from scipy.spatial.transform import Rotation

    lengths = np.linalg.norm(quaternions.clip(-2, 2), axis=1)  # clipped: squares of invalid numbers may overflow
    wrong = np.flatnonzero(~(np.abs(lengths - 1) <= UNIT_TOLERANCE))
    if len(wrong):
        raise ValueError(
            f"{name}: expected unit quaternions, got {len(wrong)} others, such as {quaternions[wrong[0]].tolist()} "
            "(x y z w)"
        )
    return Rotation.from_quat(quaternions)


def _check_same_shape(old: tuple[int, int], new: tuple[int, int], name: str) -> None:
    # Sizes are integers: half of 1051 is 525 or 526.
    if abs(new[1] * old[0] - new[0] * old[1]) > max(old):
        raise ValueError(
            f"{name}: expected the aspect ratio of {old[1]} x {old[0]} pixels, got {new[1]} x {new[0]}: is it cropped?"
        )
