"""Converts cameras of other conventions: quaternions, OpenGL axes, resized images, poses of other times; undoes lenses.

OpenCV's perspective and fisheye lenses are undone in images and their depth.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from scipy.spatial.transform import Rotation, Slerp
from torch import Tensor

from torchjoint.scene import Frame
from torchjoint.scene.checks import as_intrinsics, as_pose, check_largest
from torchjoint.scene.frame import camera_center

Matrix = npt.NDArray[np.float64]

#: From OpenGL's camera axes (x right, y up, z back) to OpenCV's; this matrix is its own inverse.
FLIP_YZ = torch.diag(torch.tensor([1.0, -1.0, -1.0, 1.0], dtype=torch.float64, device="cpu"))

#: Largest difference between a quaternion's length and 1: files give at least two digits.
UNIT_TOLERANCE = 0.02
Size = tuple[int, int]  # (W, H), as in OpenCV
#: The intrinsics of an undistorted image, and the column and row of each of its pixels in the distorted image.
Straight = tuple[Matrix, npt.NDArray[Any], npt.NDArray[Any]]


@dataclass(frozen=True, eq=False)
class Camera:
    """A camera with OpenCV's lens distortion.

    Args:
        intrinsics: [3, 3] float64, pixels; pixel centres have integer coordinates.
        size: (H, W) of the images for which the camera was calibrated; None: images of any size, and depth of theirs.
        distortion: k1, k2, p1, p2; or also k3; or also k3, k4, k5, k6, as for ``cv2.undistort``; empty = none. Of a
            fisheye: k1, k2, k3, k4, as for ``cv2.fisheye``.
        name: used in messages.
        fisheye: the lens is a fisheye: without distortion, the radius in the image grows with the angle.
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
        """
        size = (image.shape[1], image.shape[2])
        what = f"image {name!r} of {self.name}"
        intrinsics = self.intrinsics if self.size is None else scale_intrinsics(self.intrinsics, self.size, size, what)
        if depth is not None and self.size is None and depth.shape != size:
            got = f"{size[1]} x {size[0]} pixels and depth of {list(depth.shape)[::-1]}"
            raise ValueError(f"{what}: expected depth of the image's size, as its camera gives none, got {got}")
        depth = None if depth is None else resize_depth(depth, size, name)
        if self.fisheye or any(self.distortion):
            image, depth, intrinsics = undistort(image, depth, intrinsics, self.distortion, self.name, self.fisheye)
        return Frame(image, intrinsics, world_to_camera, depth=depth, name=name)


def pinhole_matrix(fx: float, fy: float, cx: float, cy: float, *, center: float = 0.0) -> Tensor:
    """Returns a camera matrix [3, 3] float64. In cx and cy the first pixel's centre is at `center`, 0 or 1/2."""
    return torch.tensor([[fx, 0, cx - center], [0, fy, cy - center], [0, 0, 1]], dtype=torch.float64)


def pinhole(numbers: Iterable[float], name: str) -> Camera:
    """Returns a camera without distortion, of fx fy cx cy width height; pixel centres have integer coordinates."""
    fx, fy, cx, cy, width, height = numbers
    return Camera(pinhole_matrix(fx, fy, cx, cy), (round(height), round(width)), name=name)


def scale_intrinsics(intrinsics: Tensor, old: tuple[int, int], new: tuple[int, int], name: str = "image") -> Tensor:
    """Returns intrinsics [3, 3] for images that were resized from (H, W) `old` to `new`, which has the same shape."""
    _check_same_shape(old, new, name)
    return stretch_intrinsics(intrinsics, old, new)


def stretch_intrinsics(intrinsics: Tensor, old: tuple[int, int], new: tuple[int, int]) -> Tensor:
    """Returns intrinsics [3, 3] for images that were resized from (H, W) `old` to `new`, each axis independently.

    Resizing maps image corners to image corners; with integer pixel centres the corners are at -1/2 and W - 1/2.
    """
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
    """Converts unit quaternions [N, 4], x y z w (Hamilton convention), to N rotations."""
    # clipped: squares of invalid numbers may overflow
    wrong = np.flatnonzero(~(np.abs(np.linalg.norm(quaternions.clip(-2, 2), axis=1) - 1) <= UNIT_TOLERANCE))
    if len(wrong):
        told = f"{name}: expected unit quaternions"
        raise ValueError(f"{told}, got {len(wrong)} others, such as {quaternions[wrong[0]].tolist()} (x y z w)")
    return Rotation.from_quat(quaternions)


def poses_from_quaternions(quaternions: Matrix, positions: Matrix, name: str) -> Tensor:
    """Converts unit quaternions [N, 4], x y z w, and translations [N, 3] to rigid transforms [N, 4, 4] float64."""
    poses = torch.eye(4, dtype=torch.float64).repeat(len(quaternions), 1, 1)
    if len(quaternions):
        poses[:, :3, :3] = torch.from_numpy(rotations_from_quaternions(quaternions, name).as_matrix())
        poses[:, :3, 3] = torch.from_numpy(positions)
        check_largest(poses, name)
    return poses


def rotations_about(axis: int, angles: Tensor) -> Tensor:
    """Returns rotations [N, 3, 3] about axis x, y or z (0, 1, 2) by angles [N] in radians."""
    return torch.from_numpy(Rotation.from_rotvec(angles[:, None].numpy() * np.eye(3)[axis]).as_matrix())


def invert_pose(pose: Tensor) -> Tensor:
    """Returns the inverse of a rigid transform [4, 4], for example world-to-camera from camera-to-world."""
    inverse = torch.eye(4, dtype=pose.dtype)
    inverse[:3, :3] = pose[:3, :3].T
    inverse[:3, 3] = camera_center(pose)
    return inverse


def checked_pose(pose: Tensor, name: str) -> Tensor:
    """Checks a rigid transform [4, 4] or [3, 4]; returns it as [4, 4] float64."""
    return as_pose(torch.cat([pose, torch.eye(4, dtype=pose.dtype)[3:]]) if len(pose) == 3 else pose, name)


def world_to_camera(camera_to_world: Tensor, name: str, *, opengl: bool = False) -> Tensor:
    """Checks a camera-to-world pose, [4, 4] or [3, 4], of OpenCV's or OpenGL's axes; returns its inverse."""
    pose = checked_pose(camera_to_world, name)
    return invert_pose(pose @ FLIP_YZ if opengl else pose)


def _check_same_shape(old: tuple[int, int], new: tuple[int, int], name: str) -> None:
    # Sizes are integers: half of 1051 is 525 or 526.
    if abs(new[1] * old[0] - new[0] * old[1]) > max(old):
        got = f"{new[1]} x {new[0]}: is it cropped?"
        raise ValueError(f"{name}: expected the aspect ratio of {old[1]} x {old[0]} pixels, got {got}")


def undistort(
    image: Tensor,
    depth: Tensor | None,
    intrinsics: Tensor,
    distortion: tuple[float, ...],
    name: str = "camera",
    fisheye: bool = False,
) -> tuple[Tensor, Tensor | None, Tensor]:
    """Undistorts image and depth; crops the view to pixels that the image covers, as nerfstudio and COLMAP do.

    Of a fisheye, the focal length stays, and so does the resolution in the middle. The image shows what fits into its
    size: of a lens that sees 180 degrees from edge to edge, about 115.

    Args:
        image: [3, H, W] uint8.
        depth: [H, W] float32 metres, 0 = unknown; resampled by nearest neighbour.
        intrinsics: [3, 3] of the distorted image, pixels.
        distortion: as in :class:`~torchjoint.datasets.cameras.Camera`.
        name: used in messages.
        fisheye: the lens is a fisheye.

    Returns:
        Image, depth and intrinsics, undistorted; the image size does not change.
    """
    import cv2

    size = (image.shape[2], image.shape[1])
    try:
        straighten = _fisheye if fisheye else _perspective
        after, columns, rows = straighten(intrinsics.numpy(), np.array(distortion, dtype=np.float64), size)
        pixels = np.ascontiguousarray(image.permute(1, 2, 0).numpy())
        straight = cv2.remap(pixels, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        of_depth = None if depth is None else cv2.remap(depth.contiguous().numpy(), columns, rows, cv2.INTER_NEAREST)
    except cv2.error as error:
        raise ValueError(f"{name}: images of {size[0]} x {size[1]} pixels cannot be undistorted: {error}") from error
    except ArithmeticError as error:
        raise ValueError(f"{name}: distortion {distortion} cannot be undone in {size[0]} x {size[1]} pixels") from error
    depth = None if of_depth is None else torch.from_numpy(of_depth)
    return torch.from_numpy(straight).permute(2, 0, 1), depth, torch.from_numpy(after)


def _perspective(before: Matrix, coefficients: Matrix, size: Size) -> Straight:
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


def _fisheye(before: Matrix, coefficients: Matrix, size: Size) -> Straight:
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


def register_depth(depth: Tensor, depth_intrinsics: Tensor, intrinsics: Tensor, size: tuple[int, int]) -> Tensor:
    """Resamples depth for a second camera with the same position and orientation.

    Args:
        depth: [h, w] metres along z, 0 = unknown.
        depth_intrinsics: [3, 3] of the depth image; pixel centres at integer coordinates; no skew.
        intrinsics: [3, 3] of the second camera; no skew.
        size: (H, W) of the second camera's images.

    Returns:
        [H, W] metres; 0 also outside of the depth image.
    """
    if depth_intrinsics[0, 1] != 0 or intrinsics[0, 1] != 0:
        raise ValueError("intrinsics: expected cameras without skew")
    indices, reached = [], []
    for axis in (1, 0):  # rows by y, columns by x
        focal, center = intrinsics[axis, axis], intrinsics[axis, 2]
        ray = (torch.arange(size[1 - axis], dtype=torch.float64) - center) / focal
        place = (ray * depth_intrinsics[axis, axis] + depth_intrinsics[axis, 2]).round()
        reached.append((place >= 0) & (place < depth.shape[1 - axis]))
        indices.append(place.clamp(0, depth.shape[1 - axis] - 1).long())
    return torch.where(reached[0][:, None] & reached[1], depth[indices[0]][:, indices[1]], 0)


def resize_nearest(image: Tensor, size: tuple[int, int]) -> Tensor:
    """Resizes labels or depth [h, w] to (H, W) by nearest neighbour."""
    if image.shape == size:
        return image
    row, column = (
        ((torch.arange(new, dtype=torch.float64) + 0.5) * old / new).long()
        for new, old in zip(size, image.shape, strict=True)
    )
    return image[row[:, None], column]


def interpolate_poses(
    rows: npt.NDArray[np.float64], wanted: npt.NDArray[np.float64], tolerance: float, name: str
) -> list[Tensor | None]:
    """Interpolates poses at the wanted times: rotations spherically, positions linearly.

    Args:
        rows: [P, 8] time tx ty tz qx qy qz qw: seconds, ascending, each time once; metres; a unit quaternion.
        wanted: [T] seconds.
        tolerance: a pose is used if it is at most this many seconds from the wanted time.
        name: used in messages.

    Returns:
        T poses [4, 4] float64, with the direction of the rows (such as camera-to-world); None where no pose is near
            enough in time.
    """
    check_largest(torch.from_numpy(rows[:, 1:]), name)
    rotations = rotations_from_quaternions(rows[:, 4:], name)
    if len(rows) == 1:  # duplicates a single pose, so that Slerp has two
        rows, rotations = np.concatenate([rows, rows + np.eye(8)[:1]]), rotations[[0, 0]]
    times = rows[:, 0]
    within = wanted.clip(times[0], times[-1])
    after = np.searchsorted(times, within).clip(1, len(times) - 1)
    nearest = np.minimum(abs(wanted - times[after - 1]), abs(wanted - times[after]))
    poses = np.tile(np.eye(4), (len(wanted), 1, 1))
    poses[:, :3, :3] = Slerp(times, rotations)(within).as_matrix()
    poses[:, :3, 3] = np.stack([np.interp(within, times, rows[:, axis]) for axis in (1, 2, 3)], axis=1)
    return [torch.from_numpy(pose) if gap <= tolerance else None for pose, gap in zip(poses, nearest, strict=True)]
