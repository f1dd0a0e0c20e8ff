"""Segments a scene while its cloud grows: the cloud is fused from the depth images of the frames that came so far.

Each frame with depth is fused. Frames from which the camera has moved on are keyframes: steps 1 and 2 find their
segments once, and keep them packed. A result takes the surface for the cloud, and does steps 3-8 with all keyframes.
"""

from __future__ import annotations

import copy
import math
import os
import threading
import warnings
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from torchjoint.config import Config
from torchjoint.datasets.fusion import MAX_DEPTH, add_frame, check_unit, surface_cloud, volume_origin, warn_of_poses
from torchjoint.datasets.volume import Volume
from torchjoint.images.segmenter import ImageSegmenter, ImageSegments
from torchjoint.joint import brightened_frame, prepare
from torchjoint.labels.label import label
from torchjoint.labels.lasting_ids import Changes, LastingIds
from torchjoint.runtime.foreign_files import damage_is
from torchjoint.runtime.memory import as_bytes, give_back
from torchjoint.runtime.messages import Stopwatch
from torchjoint.runtime.store import OffloadFile, Packed, pack, read_values, write_values
from torchjoint.runtime.threads import on_cpu, one_thread_per_operation, parallel_map
from torchjoint.scene import Cloud, Frame, Masks, Segmentation
from torchjoint.scene.checks import as_float, as_pose, check_shape
from torchjoint.scene.frame import camera_center, to_8_bits
from torchjoint.scene.hierarchy import check_granularity
from torchjoint.segments.method import LEARNED, tell_unread
from torchjoint.views.evidence import Evidence, observe_frame
from torchjoint.views.observations import Observations

#: Metres: kept depth is rounded to this, less than any sensor's noise.
DEPTH_STEP = 1e-4
#: Metres: no depth camera measures so far.
UNLIKELY = 100.0
_PACKED = ("image", "boundary", "labels", "taken", "depth")


class Keyframe(NamedTuple):
    """A frame that gives evidence."""

    name: str
    intrinsics: Tensor
    world_to_camera: Tensor
    image: Packed  #: as steps 1 and 2 saw it
    boundary: Packed
    labels: Packed
    masks: Masks | None
    taken: Packed | None = None  #: the image as it was taken, if depth is kept and the image is another one
    depth: Packed | None = None  #: in steps of DEPTH_STEP, if it is kept

    @classmethod
    def packed(cls, frame: Frame, bright: Frame, segments: ImageSegments, far: float | None) -> Keyframe:
        """A keyframe.

        Args:
            frame: as it was taken.
            bright: the same, as steps 1 and 2 saw it.
            segments: their results.
            far: metres, keeps depth up to here; None: keeps no depth.
        """
        # 8 bits are what steps 5-8 see of images.
        image, boundary = pack(to_8_bits(bright.image)), pack(to_8_bits(segments.boundary))
        labels = pack(segments.labels.to(torch.int32))
        keyframe = cls(frame.name, frame.intrinsics, frame.world_to_camera, image, boundary, labels, segments.masks)
        if far is None or frame.depth is None:
            return keyframe
        known = (frame.depth > 0) & (frame.depth <= far)
        depth = torch.where(known, (frame.depth / DEPTH_STEP).round(), 0.0).to(torch.int32)
        taken = None if bright is frame else pack(to_8_bits(frame.image))
        return keyframe._replace(taken=taken, depth=pack(depth))

    def to_dict(self) -> dict[str, Any]:
        """A dict of tensors, numbers and strings, for torch.save and loading with ``weights_only=True``."""
        values = {name: one.to_dict() if isinstance(one, Packed) else one for name, one in self._asdict().items()}
        return values | {"masks": None if self.masks is None else vars(self.masks)}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Keyframe:
        """The inverse of :meth:`to_dict`, for values of a file."""
        packed = {name: Packed.from_dict(values[name]) for name in _PACKED if values[name] is not None}
        masks = None if values["masks"] is None else Masks(**values["masks"])
        keyframe = cls(**{**values, **packed, "masks": masks})
        frame, segments = keyframe.opened()
        keyframe.measured()
        of_masks = segments.labels if masks is None else masks.atom
        for name, one in (("boundary", segments.boundary), ("labels", segments.labels), ("masks", of_masks)):
            check_shape(one, frame.size, f"{name} of keyframe {frame.name!r}")
        low, high = int(segments.labels.min()), int(segments.labels.max())
        if not -1 <= low <= high < segments.labels.numel():
            raise ValueError(f"labels of keyframe {frame.name!r}: expected -1 or more, got {low} to {high}")
        return keyframe._replace(intrinsics=frame.intrinsics, world_to_camera=frame.world_to_camera)

    @property
    def num_bytes(self) -> int:
        """Of the packed data."""
        return sum(len(part.data()) for part in self._parts().values())

    def offloaded(self, file: OffloadFile) -> Keyframe:
        """The same, with its packed data in a file."""
        parts = self._parts()
        spans = file.write([part.data() for part in parts.values()])
        values: dict[str, Any] = {name: parts[name].at(span) for name, span in zip(parts, spans, strict=True)}
        return self._replace(**values)

    def _parts(self) -> dict[str, Packed]:
        return {name: part for name in _PACKED if (part := getattr(self, name)) is not None}

    def opened(self) -> tuple[Frame, ImageSegments]:
        """The frame as steps 1 and 2 saw it, and their results."""
        frame = Frame(_image(self.image), self.intrinsics, self.world_to_camera, name=self.name)
        return frame, ImageSegments(_image(self.boundary), self.labels.unpack().long(), self.masks)

    def measured(self) -> Frame | None:
        """The frame as it was taken, with its depth; None: no depth was kept."""
        if self.depth is None:
            return None
        frame = Frame(_image(self.taken or self.image), self.intrinsics, self.world_to_camera, name=self.name)
        return replace(frame, depth=self.depth.unpack().float() * DEPTH_STEP)


def _image(packed: Packed) -> Tensor:
    return packed.unpack().float() / 255


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

    def __repr__(self) -> str:
        changes = ", ".join(f"{len(ids)} {name}" for name, ids in self.changes._asdict().items())
        return f"LiveResult({len(self.cloud.points)} points, {len(self.ids)} things, {changes})"

    @property
    def labels(self) -> Tensor:
        """The lasting id of the thing of each point, [N] int64."""
        return self.ids[self.segmentation.points]


class LiveSegmenter(nn.Module):
    """Segments what posed depth frames have shown so far.

    A result is that of a :class:`JointSegmenter` with the cloud that is fused so far and the keyframes, to the bit. One
    thread may call :meth:`update` while another one calls :meth:`result`. What it saw is kept by :meth:`save`, not by
    ``state_dict()``, which has only parameters of your own networks.

    Args:
        config: parameters; default ``Config()``. The method of step 6 is learned.
        voxel_size: metres, 0.005 to 0.05 for rooms: the distance of the points.
        step, turn: metres, degrees: a frame is a keyframe if its camera is at least this far from the last keyframe's,
            or turned by at least this angle. Smaller numbers give more evidence, and cost time and memory. 0, with
            views=0: all frames are keyframes.
        views: a frame is no keyframe if at least half of the surface that it shows is in so many keyframes already. So
            memory grows with the surface, however long the walk is. 0: no limit.
        granularity: level of the things, 0 (coarse) to 1 (superpoints, for a network that works live).
        keep_depth: keep the depth of keyframes in memory, which :meth:`set_poses` needs.
        memory: largest memory of the packed keyframes, of the voxels, and of the evidence while a result is computed,
            each; the rest goes to a temporary file, as of :class:`JointSegmenter`.
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

    #: The parameters, which cannot be changed: parts were made from them.
    config: Config = property(lambda self: self._config)  # type: ignore[assignment]
    #: Whether the depth of keyframes is kept; of earlier ones there would be none.
    keep_depth: bool = property(lambda self: self._keep_depth)  # type: ignore[assignment]

    @on_cpu()
    def __init__(
        self,
        config: Config | None = None,
        *,
        voxel_size: float = 0.02,
        step: float = 0.1,
        turn: float = 10.0,
        views: int = 40,
        granularity: float = 0.5,
        keep_depth: bool = False,
        memory: int | str | None = None,
        boundary: nn.Module | None = None,
        image_segmenter: nn.Module | None = None,
    ) -> None:
        super().__init__()
        for name, value in (("step", step), ("turn", turn), ("views", views)):
            if not (math.isfinite(value) and value >= 0):
                raise ValueError(f"{name}: expected a number >= 0, got {value}")
        check_granularity(granularity)
        self._config = config or Config()
        if (name := self.config.point_segments.method) in ("scan", "paper"):
            raise ValueError(f"config: expected point_segments.method learned (or auto, or a model), got {name}")
        tell_unread(self.config, LEARNED)
        self.step, self.turn, self.views, self.granularity = step, turn, views, granularity
        self._keep_depth, self.memory = keep_depth, as_bytes(memory)
        self.image_segmenter = ImageSegmenter(self.config, boundary, image_segmenter)
        self.stopwatch = Stopwatch()
        self._volume = Volume(voxel_size, MAX_DEPTH, self.memory)
        self._origin: Tensor | None = None
        self._pose: Tensor | None = None  # of the last keyframe
        self._views: Counter[int] = Counter()  # the keyframes that see each block of the volume
        self._keyframes: list[Keyframe] = []
        self._in_memory = 0  # bytes of the keyframes
        self._file: OffloadFile | None = None  # what does not fit
        self._to_compare: list[Frame] | None = []  # None: they were compared
        self._at_rest: list[Frame] | None = []  # the 1st, 2nd, 4th, 8th, ...; None: the camera moves, or it was told
        self._num_at_rest = 0
        self._ids = LastingIds()
        self._lock = threading.Lock()  # of the volume and the keyframes

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the keyframes."""
        return tuple(keyframe.name for keyframe in self._keyframes)

    @torch.no_grad()
    @one_thread_per_operation()
    def update(self, frames: Frame | Sequence[Frame]) -> None:
        """Fuses the depth of one or several frames, and finds the segments of those that are keyframes.

        A frame without depth adds only evidence. An error leaves out the whole frame, and those after it. A frame that
        is given twice counts twice; an interruption (Ctrl-C) may leave a frame fused that is not in `names`.

        Raises:
            ValueError: the surface has become too large; a camera is too far from the first one; or, after some
                keyframes, depth in another unit than metres.

        Warns:
            PoseWarning: the depth images do not agree at these poses; it comes after some keyframes, or with a result.
            UserWarning: a frame's depth seems to be in millimetres, though that of others is in metres.
        """
        for frame in [frames] if isinstance(frames, Frame) else list(frames):
            origin = volume_origin([frame], self._volume.voxel_size) if self._origin is None else self._origin
            has_moved, has_depth = self._has_moved(frame.world_to_camera), frame.depth is not None
            seen = add_frame(self._volume, frame, origin, only_look=True).tolist() if has_moved and has_depth else []
            if is_keyframe := has_moved and self._is_new(seen):
                bright = brightened_frame(frame)
                (segments,) = self.image_segmenter([bright], self.stopwatch)
                kept = self._stored(Keyframe.packed(frame, bright, segments, MAX_DEPTH if self.keep_depth else None))
            (self._compare if is_keyframe else self._compare_at_rest)(frame)
            if frame.depth is not None:
                with self.stopwatch("fusion"), self._lock:
                    self._origin = origin  # of what is fused, also if an interruption leaves the frame out
                    blocks = add_frame(self._volume, frame, origin)
                if self._views and not len(blocks) and float(frame.depth.max()) > UNLIKELY:
                    told = "a frame's depth is beyond reach, and not fused: in millimetres, after others in metres?"
                    warnings.warn(f"LiveSegmenter: {told}", stacklevel=2)
            self._origin = origin
            if is_keyframe:  # here nothing can fail any more
                self._views.update(seen)
                self._pose = frame.world_to_camera
                self._keyframes.append(kept)

    @torch.no_grad()
    @one_thread_per_operation()
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
            keyframes, compared = list(self._keyframes), list(self._to_compare or ())
        _check(compared)
        if not len(points):
            raise ValueError("depth: the frames so far give no surface; expected depth in metres, and right poses")
        graph, method = prepare(Cloud.checked(points, colors), self.config, method=LEARNED)
        evidence = Evidence.empty(graph, Observations(budget=self.memory))
        for first in range(0, len(keyframes), BATCH):
            opened = parallel_map(Keyframe.opened, keyframes[first : first + BATCH])
            evidence += parallel_map(lambda one: observe_frame(*one, graph, self.config, self.stopwatch), opened)
        evidence.check_seen()
        tree = method.segment(graph, evidence, self.config)
        found = label(tree, graph, evidence, self.config, self.stopwatch, images=images)
        found = found if self.granularity == 0.5 else found.at(self.granularity)
        place = ((points.double() - self._origin) / (CUBE * self._volume.voxel_size)).floor().long()
        ids, changes = self._ids.name(place[:, 0] << 42 ^ place[:, 1] << 21 ^ place[:, 2], found.points)
        return LiveResult(Cloud(points, colors), found, ids, changes)

    @torch.no_grad()
    @one_thread_per_operation()
    def set_poses(self, world_to_camera: Tensor) -> None:
        """Replaces the poses of the keyframes, for example after a loop closure.

        Later frames have poses in the same world. The cloud is fused anew, from the keyframes alone: the depth of other
        frames is not kept. Frames must not be added at the same time.

        Args:
            world_to_camera: [K, 4, 4] one for each of the keyframes, in the order of :attr:`names`.

        Raises:
            RuntimeError: the depth of keyframes was not kept.
            ValueError: another shape, or a matrix that is no pose.

        Warns:
            PoseWarning: the depth images do not agree at these poses.
        """
        if not self.keep_depth:
            raise RuntimeError("LiveSegmenter: set_poses needs the depth of keyframes; give keep_depth=True")
        if tuple(world_to_camera.shape) != (len(self._keyframes), 4, 4):
            told = f"[{len(self._keyframes)}, 4, 4], a pose for each keyframe, got {list(world_to_camera.shape)}"
            raise ValueError(f"world_to_camera: expected {told}")
        if self._origin is None or not self._keyframes:
            return
        poses = [as_pose(pose, f"world_to_camera[{index}]") for index, pose in enumerate(world_to_camera)]
        moved = [one._replace(world_to_camera=pose) for one, pose in zip(self._keyframes, poses, strict=True)]
        _check(compared := [*filter(None, map(Keyframe.measured, moved[:COMPARED]))])
        volume, views = Volume(self._volume.voxel_size, MAX_DEPTH, self.memory), Counter[int]()
        with self.stopwatch("fusion"):
            for frame in filter(None, map(Keyframe.measured, moved)):
                views.update(add_frame(volume, frame, self._origin).tolist())
        with self._lock:
            self._volume, self._keyframes, self._pose, self._views = volume, moved, poses[-1], views
            self._to_compare = None if self._to_compare is None else compared

    @on_cpu()
    def save(self, path: str | Path) -> None:
        """Writes what :meth:`restore` needs to go on from here: one file, which is replaced as a whole.

        Frames must not be added, nor results computed, at the same time.

        Raises:
            OSError: for example if the disk is full; an earlier file then stays.
        """
        values = {
            "settings": self._settings(),
            "origin": self._origin,
            "pose": self._pose,
            "views": dict(self._views),
            "volume": self._volume.state(),
            "keyframes": [keyframe.to_dict() for keyframe in self._keyframes],
            "to_compare": None if self._to_compare is None else [*map(_frame_values, self._to_compare)],
            "ids": self._ids.state(),
        }
        write_values(Path(path), values)

    @on_cpu()
    def restore(self, path: str | Path) -> None:
        """Goes on from what :meth:`save` wrote: the same frames then give the same results, to the bit.

        Args:
            path: of a segmenter with the same arguments; networks are not compared.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: it cannot be read, is damaged, or of another version, or of a segmenter with other arguments.
            OSError: the disk is full. With each error the segmenter stays as it was.
        """
        values = read_values(Path(path))
        with damage_is(f"{path}: not a state of live segmentation"):
            if values["settings"] != self._settings():
                raise ValueError(f"expected a state with {self._settings()}, got {values['settings']}")
            origin, pose, compared = values["origin"], values["pose"], values["to_compare"]
            origin = None if origin is None else as_float(origin, "origin", torch.float64)
            check_shape(torch.zeros(3) if origin is None else origin, (3,), "origin")
            pose = None if pose is None else as_pose(pose, "pose")
            views = Counter({int(block): int(count) for block, count in values["views"].items()})
            keyframes = [Keyframe.from_dict(one) for one in values["keyframes"]]
            if (origin is None or pose is None) != (not keyframes):
                raise ValueError(f"expected an origin and a pose with {len(keyframes)} keyframes")
            frames = None if compared is None else [Frame(**one) for one in compared]
            ids = LastingIds()
            ids.restore(values["ids"])
            stored = copy.copy(self)
            stored._in_memory, stored._file = 0, None
            keyframes = [stored._stored(keyframe) for keyframe in keyframes]
            self._volume.restore(values["volume"])  # the last check: nothing can fail any more
        self._origin, self._pose, self._views, self._to_compare, self._ids = origin, pose, views, frames, ids
        self._keyframes, self._in_memory, self._file = keyframes, stored._in_memory, stored._file
        self._at_rest, self._num_at_rest = [], 0  # the frames of before may be of another recording

    def _stored(self, keyframe: Keyframe) -> Keyframe:
        """The same, in the file if there is no memory left."""
        size = keyframe.num_bytes
        if self._in_memory + size > self.memory:
            self._file = self._file if self._file and self._file.process == os.getpid() else OffloadFile()
            keyframe, size = keyframe.offloaded(self._file), 0
            give_back()  # a tenth of a gigabyte that lies between the keyframes in memory
        self._in_memory += size
        return keyframe

    def _settings(self) -> dict[str, Any]:
        own = {"voxel_size": self._volume.voxel_size, "step": self.step, "turn": self.turn, "views": self.views}
        return own | {"granularity": self.granularity, "keep_depth": self.keep_depth, "config": self.config.to_dict()}

    def _is_new(self, seen: Sequence[int]) -> bool:
        return not (self.views and seen) or 2 * sum(self._views[block] < self.views for block in seen) > len(seen)

    def _has_moved(self, pose: Tensor) -> bool:
        if self._pose is None:
            return True
        moved = float((camera_center(pose) - camera_center(self._pose)).norm())
        cosine = (float((pose[:3, :3] * self._pose[:3, :3]).sum()) - 1) / 2
        return moved >= self.step or math.degrees(math.acos(max(-1.0, min(1.0, cosine)))) >= self.turn

    def _compare(self, frame: Frame) -> None:
        """Keeps the first keyframes with depth, and then compares their poses, once."""
        if frame.depth is not None and self._to_compare is not None:
            compared = [*self._to_compare, frame]
            if len(compared) == COMPARED:
                _check(compared)
            self._to_compare = compared if len(compared) < COMPARED else None

    def _compare_at_rest(self, frame: Frame) -> None:
        """Compares frames that are no keyframes while their poses are equal: a tracker may have lost its poses."""
        if frame.depth is None or self._at_rest is None:
            return
        self._num_at_rest += 1
        if self._at_rest and not torch.equal(frame.world_to_camera, self._at_rest[0].world_to_camera):
            self._at_rest = None
        elif self._num_at_rest & (self._num_at_rest - 1) == 0:
            self._at_rest.append(frame)
            self._at_rest = None if warn_of_poses(self._at_rest) else self._at_rest


def _check(frames: Sequence[Frame]) -> None:
    """Checks the unit of the depth, and warns of poses at which depth images do not agree."""
    check_unit(frames)
    warn_of_poses(frames)


def _frame_values(frame: Frame) -> dict[str, Any]:
    """The arguments of a frame for comparison."""
    return {name: getattr(frame, name) for name in ("image", "intrinsics", "world_to_camera", "depth", "name")}
