"""The data of the method: a :class:`Scene` of points and posed :class:`Frame` s, and its :class:`Segmentation`.

Conventions, everywhere in this package (other conventions are converted once, in :mod:`torchjoint.datasets`):

========================  =====================  ==========================================================
name                      shape, dtype           meaning
========================  =====================  ==========================================================
``points``                [N, 3] float32         metres, world frame
``colors``                [N, 3] float32         RGB in [0, 1]
``normals``               [N, 3] float32         unit length, world frame
``image``                 [3, H, W] float32      RGB in [0, 1]
``intrinsics``            [3, 3] float64         pixels; pixel *centres* have integer coordinates
``world_to_camera``       [4, 4] float64         rigid; OpenCV axes (x right, y down, z forward)
``depth``                 [H, W] float32         metres along z; 0 = unknown
``labels``                int64                  -1 = none
========================  =====================  ==========================================================
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import overload

import torch
from torch import Tensor

#: How far R^T R may be from the identity, and det R from 1, before a pose is refused (poses of text files have
#: 7 digits; a pose that was averaged or interpolated carelessly is off by much more).
RIGID_TOLERANCE = 1e-3

#: Metres from the origin at which float32 coordinates are still exact to a millimetre.
LARGEST_COORDINATE = 8192.0


@dataclass(frozen=True)
class Frame:
    """One posed image.

    Args:
        image: [3, H, W] RGB in [0, 1]; uint8 images are divided by 255, grey ones ([H, W] or [1, H, W]) repeated.
        intrinsics: [3, 3] camera matrix in pixels of *this* image, pixel centres at integer coordinates.
        world_to_camera: [4, 4] rigid transform, OpenCV axes. If your poses are camera-to-world, invert them.
        depth: optional [H, W], metres along the camera's z; 0 = unknown. Never used by the method itself, only to
            check poses and to fuse a cloud where there is none.
        labels: optional [H, W] integers, a segmentation of the image to start from (a network's, SAM masks, ...);
            -1 = none. It replaces steps 1-2 of the method for this frame.
        name: used for file names and messages.

    Raises:
        ValueError, TypeError: naming the argument, what was expected and what came.
    """

    image: Tensor
    intrinsics: Tensor
    world_to_camera: Tensor
    depth: Tensor | None = None
    labels: Tensor | None = None
    name: str = ""

    def __post_init__(self) -> None:
        set_ = lambda key, value: object.__setattr__(self, key, value)  # noqa: E731 (frozen: set once, here)
        set_("image", _as_image(self.image, self._called("image")))
        set_("intrinsics", _as_intrinsics(self.intrinsics, self._called("intrinsics")))
        set_("world_to_camera", as_pose(self.world_to_camera, self._called("world_to_camera")))
        if self.depth is not None:
            depth = _as_float(self.depth, self._called("depth"), torch.float32)
            _check_shape(depth, self.size, self._called("depth"))
            set_("depth", depth)
        if self.labels is not None:
            set_("labels", as_labels(self.labels, self.size, self._called("labels")))

    def _called(self, argument: str) -> str:
        return f"{argument} of frame {self.name!r}" if self.name else argument

    @property
    def size(self) -> tuple[int, int]:
        """(H, W) of the image, pixels."""
        return self.image.shape[1], self.image.shape[2]


@dataclass(frozen=True)
class Scene:
    """One point cloud and the frames that were taken of it.

    Args:
        points: [N, 3] metres, world frame; N >= 1, finite.
        frames: a sequence of :class:`Frame`; may be lazy (read at access) and may be empty (plain 3D segmentation).
        colors: optional [N, 3] RGB in [0, 1].
        normals: optional [N, 3], showing out of the surface; estimated where absent.
        name: used in messages.

    Raises:
        ValueError, TypeError: naming the argument, what was expected and what came.
    """

    points: Tensor
    frames: Sequence[Frame] = field(default_factory=tuple)
    colors: Tensor | None = None
    normals: Tensor | None = None
    name: str = ""

    def __post_init__(self) -> None:
        points = as_points(self.points)
        object.__setattr__(self, "points", points)
        if not (hasattr(self.frames, "__len__") and hasattr(self.frames, "__getitem__")):
            raise TypeError(f"frames: expected a sequence of Frame, got {type(self.frames).__name__}")
        if self.colors is not None:
            colors = _in_unit_range(self.colors, "colors")
            _check_shape(colors, tuple(points.shape), "colors")
            object.__setattr__(self, "colors", colors)
        if self.normals is not None:
            normals = _as_float(self.normals, "normals", torch.float32)
            _check_shape(normals, tuple(points.shape), "normals")
            length = normals.norm(dim=1, keepdim=True)
            if float(length.min()) < 1e-3:
                raise ValueError(f"normals: expected unit vectors, got {int((length < 1e-3).sum())} of length 0")
            object.__setattr__(self, "normals", normals / length)


class LabelImages(Sequence[Tensor]):
    """Label images of one segmentation: a sequence of [H, W] int64 tensors, kept as int32 until they are asked for."""

    def __init__(self, images: Sequence[Tensor]) -> None:
        self._images = [image.to(torch.int32) for image in images]

    def __len__(self) -> int:
        return len(self._images)

    @overload
    def __getitem__(self, index: int) -> Tensor: ...
    @overload
    def __getitem__(self, index: slice) -> LabelImages: ...
    def __getitem__(self, index: int | slice) -> Tensor | LabelImages:
        if isinstance(index, slice):
            return LabelImages(self._images[index])
        return self._images[index].to(torch.int64)


@dataclass(frozen=True)
class Segmentation:
    """Labels of points and pixels that share one id space: the same id is the same object everywhere.

    Attributes:
        points: [N] int64. Ids 0 ... num_point_segments - 1, numbered by first appearance in the cloud.
        images: a sequence of [H, W] int64, one a frame. Ids >= num_point_segments are image segments that no
            visible point fell in; such an id occurs in one image only.
        initial_images: the image segmentations the method started from (each frame has ids of its own).
        names: the frames' names, in order.
        seconds: wall-clock seconds by stage.
    """

    points: Tensor
    images: Sequence[Tensor]
    initial_images: Sequence[Tensor] = ()
    names: tuple[str, ...] = ()
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def num_point_segments(self) -> int:
        """How many segments the cloud has."""
        return int(self.points.max()) + 1 if self.points.numel() else 0


def as_points(points: Tensor, name: str = "points") -> Tensor:
    """Checks a cloud: [N, 3], N >= 1, finite, near enough to the origin; returns it as float32."""
    points = _as_float(points, name, torch.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"{name}: expected shape [N, 3], got {list(points.shape)}")
    if points.shape[0] == 0:
        raise ValueError(f"{name}: expected at least one point, got an empty cloud")
    largest = points.abs().max().item()
    if largest > LARGEST_COORDINATE:
        raise ValueError(
            f"{name}: coordinates up to {largest:.4g} m would keep only {largest * 2**-23:.2g} m in float32; subtract "
            "an offset from points and camera positions"
        )
    return points.to(torch.float32)


def as_pose(pose: Tensor, name: str = "world_to_camera") -> Tensor:
    """Checks a rigid transform [4, 4]; returns it as float64."""
    pose = _as_float(pose, name, torch.float64)
    _check_shape(pose, (4, 4), name)
    rotation = pose[:3, :3]
    error = (rotation @ rotation.T - torch.eye(3, dtype=torch.float64)).abs().max().item()
    determinant = torch.linalg.det(rotation).item()
    last_row = (pose[3] - torch.tensor([0.0, 0.0, 0.0, 1.0], dtype=torch.float64)).abs().max().item()
    if error > RIGID_TOLERANCE or abs(determinant - 1) > RIGID_TOLERANCE or last_row > RIGID_TOLERANCE:
        raise ValueError(
            f"{name}: expected a rigid transform [R t; 0 1], got R R^T off the identity by {error:.3g}, "
            f"det R = {determinant:.6g}, last row {pose[3].tolist()}"
        )
    return pose


def as_labels(labels: Tensor, size: tuple[int, int], name: str = "labels") -> Tensor:
    """Checks a label image [H, W] of integers >= -1; returns it as int64."""
    if not isinstance(labels, Tensor):
        raise TypeError(f"{name}: expected a torch.Tensor, got {type(labels).__name__}")
    if labels.dtype.is_floating_point or labels.dtype.is_complex:
        raise TypeError(f"{name}: expected an integer dtype, got {labels.dtype}")
    _check_shape(labels, size, name)
    labels = labels.to(torch.int64)
    if labels.numel() and int(labels.min()) < -1:
        raise ValueError(f"{name}: expected labels >= -1 (-1 = none), got {int(labels.min())}")
    return labels


def _as_image(image: Tensor, name: str) -> Tensor:
    if not isinstance(image, Tensor):
        raise TypeError(f"{name}: expected a torch.Tensor, got {type(image).__name__}")
    if image.ndim == 2:
        image = image[None]
    if image.ndim != 3 or image.shape[0] not in (1, 3):
        raise ValueError(f"{name}: expected shape [3, H, W] (or grey: [1, H, W], [H, W]), got {list(image.shape)}")
    if image.numel() == 0:
        raise ValueError(f"{name}: expected at least one pixel, got {list(image.shape)}")
    return _in_unit_range(image, name).expand(3, -1, -1)


def _in_unit_range(value: Tensor, name: str) -> Tensor:
    """Checks colours in [0, 1]; returns them as float32, 8-bit ones divided by 255."""
    if isinstance(value, Tensor) and value.dtype == torch.uint8:
        value = value.to(torch.float32) / 255
    value = _as_float(value, name, torch.float32)
    low, high = (value.min().item(), value.max().item()) if value.numel() else (0.0, 0.0)
    if low < -1e-4 or high > 1 + 1e-4:
        raise ValueError(f"{name}: expected values in [0, 1] (or uint8), got [{low:.4g}, {high:.4g}]")
    return value.clamp(0, 1)


def _as_intrinsics(intrinsics: Tensor, name: str) -> Tensor:
    intrinsics = _as_float(intrinsics, name, torch.float64)
    _check_shape(intrinsics, (3, 3), name)
    zeros = intrinsics[[1, 2, 2], [0, 0, 1]]
    if (
        intrinsics[0, 0] <= 0
        or intrinsics[1, 1] <= 0
        or zeros.abs().max() > 1e-9
        or (intrinsics[2, 2] - 1).abs() > 1e-9
    ):
        raise ValueError(
            f"{name}: expected [[fx, s, cx], [0, fy, cy], [0, 0, 1]] with fx, fy > 0, got {intrinsics.tolist()}"
        )
    return intrinsics


def _as_float(value: Tensor, name: str, dtype: torch.dtype) -> Tensor:
    if not isinstance(value, Tensor):
        raise TypeError(f"{name}: expected a torch.Tensor, got {type(value).__name__}")
    if value.device.type != "cpu":
        raise ValueError(f"{name}: expected a CPU tensor, got one on {value.device}")
    if not value.dtype.is_floating_point:
        raise TypeError(f"{name}: expected a floating dtype, got {value.dtype}")
    if not torch.isfinite(value).all():
        count = int((~torch.isfinite(value)).sum())
        raise ValueError(f"{name}: expected finite values, got {count} NaN or infinite of {value.numel()}")
    return value.detach().to(dtype)


def _check_shape(value: Tensor, shape: tuple[int, ...], name: str) -> None:
    if tuple(value.shape) != tuple(shape):
        raise ValueError(f"{name}: expected shape {list(shape)}, got {list(value.shape)}")
