"""Segments a scene while its cloud grows: the cloud is fused from the depth images of the frames that came so far.

Each frame with depth is fused. Frames from which the camera has moved on are keyframes: steps 1 and 2 find their
segments once, and keep them packed. A result takes the surface for the cloud, and does steps 3-8 with all keyframes.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor, nn

from torchjoint.config import Config
from torchjoint.datasets.depth_agreement import warn_of_poses
from torchjoint.datasets.fusion import FAR, add_frame, check_unit, surface_cloud, volume_origin
from torchjoint.datasets.volume import Volume
from torchjoint.images.segmenter import ImageSegmenter, ImageSegments
from torchjoint.joint import JointSegmenter
from torchjoint.labels.lasting_ids import Changes, LastingIds
from torchjoint.runtime.packing import Packed, pack
from torchjoint.runtime.stopwatch import Stopwatch
from torchjoint.runtime.threads import on_cpu, parallel_map
from torchjoint.scene import Cloud, Frame, Masks, Segmentation
from torchjoint.scene.camera import camera_center
from torchjoint.segments.learned.method import Learned

#: The depth of this many keyframes is checked, and compared at their poses. One image without depth is no error.
COMPARED = 12
#: Results are compared in cubes of this many voxels a side.
CUBE = 2
#: Keyframes that are unpacked at once.
BATCH = 8


class LiveResult(NamedTuple):
    """The things so far.

    Its cloud changes from result to result; the ids of its things last.
    """

    cloud: Cloud  #: the N points that have been fused so far, with colours
    segmentation: Segmentation  #: of the cloud and the keyframes; segments are numbered 0 ... S - 1
    ids: Tensor  #: [S] int64, the lasting id of each segment
    changes: Changes  #: since the result before

    @property
    def labels(self) -> Tensor:
        """The lasting id of the thing of each point, [N] int64."""
        return self.ids[self.segmentation.points]


class LiveSegmenter(nn.Module):
    """Segments what posed depth frames have shown so far.

    A result is that of a :class:`JointSegmenter` with the cloud that is fused so far and the keyframes, to the bit. One
    thread may call :meth:`update` while another one calls :meth:`result`.

    Args:
        config: parameters; default ``Config()``. The method of step 6 is learned.
        voxel_size: metres, 0.005 to 0.05 for rooms: the distance of the points.
        step, turn: metres, degrees: a frame is a keyframe if its camera is at least this far from the last keyframe's,
            or turned by at least this angle. Smaller numbers give more evidence, and cost time and memory. 0: all
            frames are keyframes.
        boundary, image_segmenter: as of :class:`JointSegmenter`.

    Example:
        >>> import torchjoint as tj
        >>> segmenter = tj.LiveSegmenter(voxel_size=0.05)
        >>> for frame in tj.synthetic.make_scene(seed=0).scene.frames:
        ...     segmenter.update(frame)
        >>> result = segmenter.result()
        >>> len(result.cloud.points) == len(result.labels), len(result.changes.born) == len(result.ids)
        (True, True)
    """

    def __init__(
        self,
        config: Config | None = None,
        *,
        voxel_size: float = 0.02,
        step: float = 0.1,
        turn: float = 10.0,
        boundary: nn.Module | None = None,
        image_segmenter: nn.Module | None = None,
    ) -> None:
        super().__init__()
        if not 1e-4 <= voxel_size <= 10:
            raise ValueError(f"voxel_size: expected 0.0001 to 10 metres, got {voxel_size}")
        for name, value in (("step", step), ("turn", turn)):
            if not (math.isfinite(value) and value >= 0):
                raise ValueError(f"{name}: expected a number >= 0, got {value}")
        self.config = config or Config()
        name = self.config.point_segments.method
        if name in ("scan", "paper"):
            raise ValueError(f"config: expected point_segments.method learned (or auto, or a model), got {name}")
        self.step, self.turn = step, turn
        self.image_segmenter = ImageSegmenter(self.config, boundary, image_segmenter)
        self.stopwatch = Stopwatch()
        self._method = Learned(self.config)
        self._volume = Volume(voxel_size, FAR)
        self._origin: Tensor | None = None
        self._pose: Tensor | None = None  # of the last keyframe
        self._keyframes: list[_Keyframe] = []
        self._to_compare: list[Frame] | None = []  # None: they were compared
        self._ids = LastingIds()
        self._lock = threading.Lock()  # of the volume and the keyframes

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the keyframes."""
        return tuple(keyframe.name for keyframe in self._keyframes)

    @torch.no_grad()
    @on_cpu()
    def update(self, frames: Frame | Sequence[Frame]) -> None:
        """Fuses the depth of one or several frames, and finds the segments of those that are keyframes.

        A frame without depth adds only evidence.

        Raises:
            ValueError: the surface has become too large; a camera is too far from the first one; or, after some
                keyframes, depth in another unit than metres.

        Warns:
            PoseWarning: the depth images do not agree at these poses; it comes after some keyframes.
        """
        frames = [frames] if isinstance(frames, Frame) else list(frames)
        for frame in frames:
            if self._origin is None:
                self._origin = volume_origin([frame], self._volume.voxel_size)
            if frame.depth is not None:
                with self.stopwatch("fusion"), self._lock:
                    add_frame(self._volume, frame, self._origin)
            if self._is_keyframe(frame.world_to_camera):
                self._pose = frame.world_to_camera
                self._compare(frame)
                developed = self._method.developed(frame)
                (segments,) = self.image_segmenter([developed], self.stopwatch)
                self._keyframes.append(_Keyframe.packed(developed, segments))

    @torch.no_grad()
    @on_cpu()
    def result(self, *, images: bool = True) -> LiveResult:
        """The things so far; more frames may follow. Results must not be computed at the same time.

        Args:
            images: False: no labels of the keyframes' pixels, which take most of the time.

        Raises:
            RuntimeError: no frame has come.
            ValueError: the depth images give no surface, or have another unit; or no keyframe sees it.
        """
        if self._origin is None:
            raise RuntimeError("LiveSegmenter: call update(frame) first")
        with self.stopwatch("surface"), self._lock:
            points, colors = surface_cloud(self._volume, self._origin)
            keyframes = list(self._keyframes)
        if not len(points):
            check_unit(self._to_compare or [])
            raise ValueError("depth: the frames so far give no surface; expected depth in metres, and right poses")
        segmenter = JointSegmenter(self.config, method=lambda config, _: Learned(config))
        segmenter.reset(points, colors)
        for first in range(0, len(keyframes), BATCH):
            opened = parallel_map(_Keyframe.opened, keyframes[first : first + BATCH])
            segmenter.observe(*zip(*opened, strict=True))
        found = segmenter.compute(images=images)
        side = CUBE * self._volume.voxel_size
        place = ((points.double() - self._origin) / side).floor().long()
        ids, changes = self._ids.name(place[:, 0] << 42 ^ place[:, 1] << 21 ^ place[:, 2], found.points)
        return LiveResult(Cloud(points, colors), found, ids, changes)

    def _is_keyframe(self, pose: Tensor) -> bool:
        if self._pose is None:
            return True
        moved = float((camera_center(pose) - camera_center(self._pose)).norm())
        cosine = (float((pose[:3, :3] * self._pose[:3, :3]).sum()) - 1) / 2
        return moved >= self.step or math.degrees(math.acos(max(-1.0, min(1.0, cosine)))) >= self.turn

    def _compare(self, frame: Frame) -> None:
        """Keeps the first keyframes with depth, and then compares their poses, once."""
        if frame.depth is None or self._to_compare is None:
            return
        self._to_compare.append(frame)
        if len(self._to_compare) == COMPARED:
            check_unit(self._to_compare)
            warn_of_poses(self._to_compare)
            self._to_compare = None


class _Keyframe(NamedTuple):
    """The results of steps 1 and 2 for one frame, packed, and its camera."""

    name: str
    intrinsics: Tensor
    world_to_camera: Tensor
    image: Packed
    boundary: Packed
    labels: Packed
    masks: Masks | None

    @classmethod
    def packed(cls, frame: Frame, segments: ImageSegments) -> _Keyframe:
        # 8 bits are what steps 5-8 see of images.
        image, boundary = (values.mul(255).round().to(torch.uint8) for values in (frame.image, segments.boundary))
        labels = segments.labels.to(torch.int32)
        return cls(
            frame.name,
            frame.intrinsics,
            frame.world_to_camera,
            pack(image),
            pack(boundary),
            pack(labels),
            segments.masks,
        )

    def opened(self) -> tuple[Frame, ImageSegments]:
        frame = Frame(self.image.unpack(), self.intrinsics, self.world_to_camera, name=self.name)
        segments = ImageSegments(self.boundary.unpack().float() / 255, self.labels.unpack().long(), self.masks)
        return frame, segments
