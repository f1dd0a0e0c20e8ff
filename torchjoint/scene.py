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

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar, cast, overload

import torch
from torch import Tensor
from torch.utils.data import Dataset, Subset

from torchjoint.scene_checks import (
    as_float,
    as_image,
    as_intrinsics,
    as_labels,
    as_points,
    as_pose,
    as_unit_range,
    check_shape,
)

T = TypeVar("T")


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
        set_("image", as_image(self.image, self._called("image")))
        set_("intrinsics", as_intrinsics(self.intrinsics, self._called("intrinsics")))
        set_("world_to_camera", as_pose(self.world_to_camera, self._called("world_to_camera")))
        if self.depth is not None:
            depth = as_float(self.depth, self._called("depth"), torch.float32)
            check_shape(depth, self.size, self._called("depth"))
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
class Truth:
    """What is known to be right about a scene: only ever compared with results, never used to make them.

    Args:
        points: optional [N] integers, the instance of each point, -1 = not known (void).
        images: label images [H, W], -1 = void, one for each frame (may be lazy); empty where there are none. Their
            number is checked where they are used.
        kinds: of those instances whose scores are wanted by kind: instance -> kind, such as "flat".
    """

    points: Tensor | None = None
    images: Sequence[Tensor] = ()
    kinds: Mapping[int, str] = field(default_factory=dict)

    @property
    def has_points(self) -> bool:
        """Whether the instance of any point is known."""
        return self.points is not None and bool((self.points >= 0).any())

    def select_points(self, keep: Tensor) -> Truth:
        """That of some of the points, in the order of `keep` (a mask, or places)."""
        return self if self.points is None else replace(self, points=self.points[keep])

    def select_frames(self, indices: Sequence[int]) -> Truth:
        """That of some of the frames."""
        return replace(self, images=_subset(self.images, indices)) if len(self.images) else self


@dataclass(frozen=True)
class Scene:
    """One point cloud and the frames that were taken of it.

    Args:
        points: [N, 3] metres, world frame; N >= 1, finite.
        frames: a sequence of :class:`Frame`; may be lazy (read at access) and may be empty (plain 3D segmentation).
        colors: optional [N, 3] RGB in [0, 1].
        normals: optional [N, 3], showing out of the surface; estimated where absent.
        name: used in messages.
        truth: optional, what is known to be right about it; the method never looks at it.

    Raises:
        ValueError, TypeError: naming the argument, what was expected and what came.
    """

    points: Tensor
    frames: Sequence[Frame] = field(default_factory=tuple)
    colors: Tensor | None = None
    normals: Tensor | None = None
    name: str = ""
    truth: Truth | None = None

    def __post_init__(self) -> None:
        points = as_points(self.points)
        object.__setattr__(self, "points", points)
        if not (hasattr(self.frames, "__len__") and hasattr(self.frames, "__getitem__")):
            raise TypeError(f"frames: expected a sequence of Frame, got {type(self.frames).__name__}")
        if self.colors is not None:
            colors = as_unit_range(self.colors, "colors")
            check_shape(colors, tuple(points.shape), "colors")
            object.__setattr__(self, "colors", colors)
        if self.normals is not None:
            normals = as_float(self.normals, "normals", torch.float32)
            check_shape(normals, tuple(points.shape), "normals")
            length = normals.norm(dim=1, keepdim=True)
            if float(length.min()) < 1e-3:
                raise ValueError(f"normals: expected unit vectors, got {int((length < 1e-3).sum())} of length 0")
            object.__setattr__(self, "normals", normals / length)
        if self.truth is not None and self.truth.points is not None:
            as_labels(self.truth.points, (len(points),), "truth.points")

    def select_points(self, keep: Tensor) -> Scene:
        """The scene with some of its points, in the order of `keep` (a mask [N], or places)."""
        return replace(
            self,
            points=self.points[keep],
            colors=None if self.colors is None else self.colors[keep],
            normals=None if self.normals is None else self.normals[keep],
            truth=None if self.truth is None else self.truth.select_points(keep),
        )

    def spread_frames(self, most: int) -> Scene:
        """The scene with at most so many of its frames, evenly spread from the first to the last; they stay lazy."""
        if most >= len(self.frames):
            return self
        return self.select_frames(torch.linspace(0, len(self.frames) - 1, most).round().long().tolist())

    def select_frames(self, indices: Sequence[int]) -> Scene:
        """The scene with some of its frames, in the order of `indices`; they stay lazy."""
        return replace(
            self,
            frames=_subset(self.frames, indices),
            truth=None if self.truth is None else self.truth.select_frames(indices),
        )


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


def _subset(items: Sequence[T], indices: Sequence[int]) -> Sequence[T]:
    return cast(Sequence[T], Subset(cast(Dataset[T], items), indices))
