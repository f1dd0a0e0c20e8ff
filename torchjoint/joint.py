"""The joint segmentation of a point cloud and its images: Algorithm 1 of the paper.

M. Abello, J. Mangelson, M. Kaess, "A Graph-Based Method for Joint Instance Segmentation of Point Clouds and Image
Sequences", ICRA 2021. Its steps: ``reset`` (3), ``add`` (1, 2, 4, 5) and ``compute`` (6-8); the rest serves them.
"""

from __future__ import annotations

import logging
import math
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from copy import copy
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn
from tqdm import tqdm

from torchjoint.cloud.local import warn_of_rounding, without_copies
from torchjoint.cloud.prepared import PreparedCloud
from torchjoint.config import Config, evidence_differences
from torchjoint.images.segmenter import ImageSegmenter, ImageSegments
from torchjoint.labels.image_labels import label_images
from torchjoint.labels.piece_images import PieceImages
from torchjoint.results.checkpoint import Checkpoint
from torchjoint.runtime.ahead import ahead
from torchjoint.runtime.lazy import LazySequence
from torchjoint.runtime.memory import as_bytes
from torchjoint.runtime.stopwatch import Stopwatch
from torchjoint.runtime.threads import on_cpu, one_thread_per_operation, parallel_map
from torchjoint.scene import Cloud, Frame, Scene, Segmentation
from torchjoint.scene.level_images import LevelImages
from torchjoint.segments.choice import choose_method, describe
from torchjoint.segments.method import Method
from torchjoint.segments.point_labels import label_points
from torchjoint.views.frame_evidence import add_evidence
from torchjoint.views.observations import Observations
from torchjoint.views.pose_check import PoseCheck, frames_to_check
from torchjoint.views.state import JointState

logger = logging.getLogger(__name__)

#: A function (segmenter, scene) that observes a run while its frames are added. It must not change its arguments.
Watch = Callable[["JointSegmenter", Scene], None]


class JointSegmenter(nn.Module):
    """Segments one point cloud and a sequence of posed images together.

    Call ``segmenter(scene)`` for a whole scene. Or work frame by frame: call :meth:`reset` with the cloud,
    :meth:`update` with frames in any order, and :meth:`compute` at any time. Both ways give the same labels. The labels
    do not depend on the order of the frames or on the number of threads. :meth:`merge` merges segmenters that saw
    different frames of one cloud.

    Args:
        config: parameters; default ``Config()``.
        method: function (config, points) that makes the method of step 6; default: the method that the config names
            (:func:`~torchjoint.segments.choice.choose_method`).
        boundary: a boundary detector, [B, 3, H, W] RGB in [0, 1] -> [B, H, W] in [0, 1]; it replaces the detector
            that the config names (step 1).
        image_segmenter: any module [B, 3, H, W] -> [B, H, W] integer labels, -1 = none, or -> B
            :class:`~torchjoint.scene.Masks`; it replaces the graph segmentation of images (step 2). If a frame has
            masks or labels, they are used instead.
        merge_within: metres; the points in one cube with this side are merged to their mean, and all get its label. Use
            it for scans that overlap with small errors. Method scan ignores it. Exact copies are always merged.
        memory: largest memory of the frames' evidence for steps 6-8: "2GB", "500 MiB", or bytes. The rest is packed to
            a temporary file. The labels do not depend on it. Default: a quarter of the memory of the machine or
            container.
        spill: folder of the temporary file; default: TMPDIR, or /var/tmp. The file has no name, and the system removes
            it when the process ends.
        allow_import: import the code that the config names (``boundary.detector=package.module:Class``). Do not allow
            it for a config that came from others, such as that of their result.

    Example:
        >>> import torchjoint as tj
        >>> scene = tj.synthetic.make_scene(seed=0).scene
        >>> result = tj.JointSegmenter()(scene)
        >>> result.points.shape, len(result.images)
        (torch.Size([6000]), 6)
    """

    def __init__(
        self,
        config: Config | None = None,
        *,
        method: Callable[[Config, Tensor], Method] = choose_method,
        boundary: nn.Module | None = None,
        image_segmenter: nn.Module | None = None,
        merge_within: float = 0.0,
        memory: int | str | None = None,
        spill: str | Path | None = None,
        allow_import: bool = False,
    ) -> None:
        super().__init__()
        if config is not None and not isinstance(config, Config):
            raise TypeError(
                f"config: expected a Config, got {type(config).__name__}; see JointSegmenter.from_preset('paper')"
            )
        if not (math.isfinite(merge_within) and merge_within >= 0):
            raise ValueError(f"merge_within: expected metres >= 0, got {merge_within}")
        self.merge_within = merge_within
        self._memory = as_bytes(memory)
        self._spill = None if spill is None else Path(spill)
        self.config = config or Config()
        self.image_segmenter = ImageSegmenter(self.config, boundary, image_segmenter, allow_import)
        self.stopwatch = Stopwatch()
        self._make_method = method
        self._given: Tensor | None = None  # [M, 3], the given points without copies
        self._method: Method | None = None
        self._cloud: PreparedCloud | None = None
        self._check: PoseCheck | None = None  # of frames that come one by one
        self._state: JointState | None = None

    @classmethod
    def from_preset(cls, name: str) -> JointSegmenter:
        """A segmenter with one of the package's presets, such as ``"paper"``, or a YAML file.

        Raises:
            ValueError, TypeError: an unknown preset, or a bad file; the message names it.
        """
        return cls(Config.from_preset(name))

    @torch.no_grad()
    @on_cpu()
    def forward(
        self,
        scene: Scene,
        *,
        progress: bool = False,
        batch_size: int = 8,
        checkpoint: Checkpoint | None = None,
        on_frames: Watch | None = None,
    ) -> Segmentation:
        """Segments a whole scene (steps 1-8).

        Args:
            scene: the cloud and its frames; without frames this is plain 3D segmentation.
            progress: show progress bars.
            batch_size: number of frames that are processed at a time; meanwhile the next batch is loaded.
            checkpoint: saves the state at intervals; an interrupted run resumes from it.
            on_frames: called with the segmenter and the scene before the first frame and after each batch, for example
                to show the labels so far; it must not change them.

        Returns:
            labels of the points [N] and of the frames [H, W]; see :class:`~torchjoint.scene.Segmentation`.

        Raises:
            TypeError: `scene` is not a Scene.
            ValueError: the scene has frames, but none of them sees a point.

        Warns:
            PoseWarning: the poses or intrinsics look wrong.
        """
        checked = self.begin(scene, checkpoint)
        steps = self._add_batches(scene.frames, batch_size, checked)
        return self.finish(scene, steps, progress=progress, checkpoint=checkpoint, on_frames=on_frames)

    if TYPE_CHECKING:  # the one of nn.Module is untyped
        __call__ = forward

    @torch.no_grad()
    @on_cpu()
    def begin(self, scene: Scene, checkpoint: Checkpoint | None = None) -> dict[int, Frame]:
        """Prepares a scene: calls :meth:`reset`, checks the poses, and loads the state of a checkpoint.

        Returns:
            the frames that the check of poses has read, by index.

        Raises:
            TypeError: `scene` is not a Scene.

        Warns:
            PoseWarning: the poses or intrinsics look wrong.
        """
        if not isinstance(scene, Scene):
            raise TypeError(f"scene: expected a Scene, got {type(scene).__name__}; make one: Scene(points, frames)")
        self._reset(scene.cloud)
        checked = frames_to_check(scene)
        if checked:
            check = self._new_check(scene.name)
            check.look_at(checked.values())
            check.warn()
        if checkpoint is not None:
            self.state = checkpoint.load(Observations(budget=self._memory, folder=self._spill)) or self.state
        return checked

    @torch.no_grad()
    @on_cpu()
    def finish(
        self,
        scene: Scene,
        steps: Iterable[int],
        *,
        progress: bool = False,
        checkpoint: Checkpoint | None = None,
        on_frames: Watch | None = None,
    ) -> Segmentation:
        """Adds the evidence of all frames after :meth:`begin`, and computes the labels.

        Args:
            scene: as for :meth:`begin`.
            steps: an iterable; each step adds the evidence of some frames to this segmenter and gives their number.
            progress, checkpoint, on_frames: as for :meth:`forward`.
        """
        if on_frames is not None:
            on_frames(self, scene)
        count, done = len(scene.frames), len(self.state.observations)
        with tqdm(total=count, initial=done, desc="frames", unit="frame", disable=not progress) as bar:
            for number in steps:
                bar.update(number)
                if checkpoint is not None:
                    checkpoint.save(self.state)
                if on_frames is not None:
                    on_frames(self, scene)
        if checkpoint is not None:
            checkpoint.save(self.state, now=True)
        return self.compute(progress=progress)

    def _add_batches(self, frames: Sequence[Frame], batch_size: int, checked: dict[int, Frame]) -> Iterator[int]:
        """Adds the frames that are not in the state yet. Frames in `checked` are taken from it and not read again."""

        def load(indices: range) -> list[Frame]:
            with self.stopwatch("load frames"):
                return parallel_map(lambda index: checked.pop(index, None) or frames[index], indices)

        count = len(frames)
        starts = range(len(self.state.observations), count, batch_size)
        for batch in ahead(load, [range(count)[start : start + batch_size] for start in starts]):
            self.add(batch)
            yield len(batch)

    @torch.no_grad()
    @on_cpu()
    def reset(self, points: Tensor, colors: Tensor | None = None, normals: Tensor | None = None) -> None:
        """Forgets all frames, makes the method of step 6, and builds the graph of a cloud (step 3).

        Logs the measured scales and the method in one line (logger ``torchjoint.joint``, level INFO).

        Args:
            points: [N, 3] metres, world frame.
            colors: optional [N, 3] RGB in [0, 1]. Method learned uses them; if they are absent or all equal, it uses
                the colours of the frames. Method paper uses them if its color_weight is > 0.
            normals: optional [N, 3], estimated if absent. Normals are oriented to the cameras that see their points.

        Raises:
            ValueError, TypeError: naming the argument, what was expected and what came.
        """
        self._reset(Cloud.checked(points, colors, normals))

    def _reset(self, given: Cloud) -> None:
        self.stopwatch = Stopwatch()
        with one_thread_per_operation(), self.stopwatch("point graph"):
            distinct, of_point = without_copies(given)
            self._given = distinct.points
            self._method = self._make_method(self.config, distinct.points)
            self._cloud = self._method.prepare(distinct, self.merge_within).of_given(of_point)
            if self._cloud.graph.known_spacing is not None:
                warn_of_rounding(given.points, self._cloud.graph.known_spacing)
            if logger.isEnabledFor(logging.INFO):
                logger.info(describe(given, self._cloud.graph, self._method))
        self._state = self._no_evidence(Observations(budget=self._memory, folder=self._spill))
        self._check = None

    @torch.no_grad()
    @on_cpu()
    def update(self, frames: Frame | Sequence[Frame]) -> None:
        """Adds the evidence of one or several frames (steps 1, 2, 4, 5).

        The image modules process consecutive frames of the same size as one batch.

        Raises:
            RuntimeError: :meth:`reset` was not called before.
            ValueError: a boundary detector or an image segmenter returns a wrong shape or bad values.
            OSError: the temporary file (see `spill`) cannot be written. Consecutive frames of one size are added
                together or not at all; the frames before them stay added.

        Warns:
            PoseWarning: the poses or intrinsics look wrong. It comes after some frames, or in :meth:`compute`.
        """
        frames = [frames] if isinstance(frames, Frame) else list(frames)
        self._check = self._check or self._new_check()
        self._check.look_as_they_come(frames)
        self.add(frames)

    @torch.no_grad()
    @on_cpu()
    def add(self, frames: Sequence[Frame]) -> None:
        """As :meth:`update`, but without a check of poses, for example because :meth:`begin` has checked them."""
        if not self.state.observations and frames:
            self._tell_unused(frames[0])
        with one_thread_per_operation():
            for _, same_size in groupby(frames, key=lambda frame: frame.size):
                batch = parallel_map(self.method.developed, list(same_size))
                self.observe(batch, self.image_segmenter(batch, self.stopwatch))

    def observe(self, developed: Sequence[Frame], segments: Sequence[ImageSegments]) -> None:
        """Steps 4 and 5 of :meth:`add`, for frames that the method has developed, and their segments."""
        cloud, method = self.cloud, self.method
        with one_thread_per_operation():
            seen = parallel_map(
                lambda item: method.observe(*item, cloud, self.stopwatch), zip(developed, segments, strict=True)
            )
            add_evidence(self.state, seen)

    def _tell_unused(self, frame: Frame) -> None:
        """Logs that images do not affect the segments of the points; warns if frames have masks or labels for this."""
        if self.method.uses_images:
            return
        name = self.method.name
        logger.info(f"frames: method {name} segments the points without images; images only get the points' labels")
        given = "masks" if frame.masks is not None else "labels" if frame.labels is not None else ""
        if given:
            warnings.warn(
                f"{given} of frames: method {name} segments the points without images, so these {given} have no effect "
                "on the points; point_segments.method=learned uses them",
                stacklevel=3,
            )

    @torch.no_grad()
    @on_cpu()
    def compute(self, *, images: bool = True, progress: bool = False) -> Segmentation:
        """Computes the segmentation from all frames seen so far (steps 6-8); more frames may follow.

        Args:
            images: False: skip steps 7-8, which take most of the time; the result then has no label images.
            progress: show a progress bar.

        Returns:
            labels of the points [N] and of the frames [H, W], frames in the order in which they were added. Method
            learned also gives all other levels, see :meth:`torchjoint.Segmentation.at`.

        Raises:
            RuntimeError: :meth:`reset` was not called before.
            ValueError: there are frames, but none of them sees a point.

        Warns:
            PoseWarning: the poses or intrinsics look wrong.
        """
        cloud, state = self.cloud, self.state
        if self._check is not None:
            self._check.warn()
        seen, count = state.observations[:], len(state.observations)  # results keep them; more frames may follow
        if count and not seen.see_points:
            raise ValueError(f"frames: none of the {count} images sees a point; wrong poses, axes or units?")
        with one_thread_per_operation():
            with self.stopwatch("point segments"):
                found = label_points(self.method, cloud, state)
            if not images:
                return Segmentation(found.given, (), seconds=dict(self.stopwatch.seconds), hierarchy=found.hierarchy)
            labels, known = label_images(
                seen, found.of_graph, self.config, self.stopwatch, found.graph_hierarchy, progress=progress
            )
        pieces: Sequence[Tensor] = ()
        if found.graph_hierarchy is not None and found.piece_number is not None:
            pieces = PieceImages(labels, seen, found.graph_hierarchy, self.config, known)
            pieces = LevelImages(pieces, len(found.piece_number), found.piece_number, len(found.piece_number))
        return Segmentation(
            points=found.given,
            images=LevelImages(labels, len(found.number), found.number, len(found.number)),
            initial_images=LazySequence(count, lambda index: seen[index].initial_labels().long()),
            names=tuple(seen.names),
            seconds=dict(self.stopwatch.seconds),
            hierarchy=found.hierarchy,
            piece_images=pieces,
        )

    @property
    def cloud(self) -> PreparedCloud:
        """The cloud that :meth:`reset` has prepared for the steps, with its graph.

        Raises:
            RuntimeError: :meth:`reset` was not called before.
        """
        if self._cloud is None:
            raise RuntimeError("JointSegmenter: call reset(points) first")
        return self._cloud

    @property
    def method(self) -> Method:
        """The method of step 6 that :meth:`reset` has made.

        Raises:
            RuntimeError: :meth:`reset` was not called before.
        """
        if self._method is None:
            raise RuntimeError("JointSegmenter: call reset(points) first")
        return self._method

    @property
    def state(self) -> JointState:
        """The evidence collected since :meth:`reset`; set it to resume a run.

        Raises:
            RuntimeError: :meth:`reset` was not called before.
            ValueError: (when set) the state belongs to another cloud.
        """
        if self._state is None:
            raise RuntimeError("JointSegmenter: call reset(points) before update, compute or state")
        return self._state

    @state.setter
    def state(self, state: JointState) -> None:
        self.state.check_cloud(state, "state")
        self._state = state

    def merge(self, other: JointSegmenter) -> None:
        """Adds the evidence of another segmenter, which saw other frames of the same cloud with the same config.

        Raises:
            ValueError: another config or cloud, or both segmenters saw a frame of the same name.
        """
        if other.config != self.config:
            raise ValueError("other: expected a segmenter with the same config")
        if self._cloud is None or other._cloud is None or not self._cloud.is_same(other._cloud):
            raise ValueError("other: expected a segmenter that was reset with the same points")
        both = set(filter(None, self.state.observations.names)) & set(other.state.observations.names)
        if other is self or both:
            raise ValueError(f"other: expected a segmenter that saw other frames, both saw {sorted(both)[:3]}")
        self.state = self.state + other.state

    @on_cpu()
    def without_evidence(self) -> JointSegmenter:
        """A segmenter of the same cloud without evidence of frames. It shares the cloud's graph, and can be pickled.

        Raises:
            RuntimeError: :meth:`reset` was not called before.
        """
        other = copy(self)
        other._state = self._no_evidence(Observations())
        other._check, other.stopwatch = None, Stopwatch()
        return other

    @on_cpu()
    def with_config(self, config: Config) -> JointSegmenter:
        """A segmenter with the same evidence and another config, to try parameters without processing the frames again.

        Raises:
            RuntimeError: :meth:`reset` was not called before.
            ValueError: the stored evidence depends on a parameter that differs; the message names the parameter.
        """
        cloud, modules, given = self.cloud, self.image_segmenter, self._given
        assert given is not None  # there is a cloud
        method = self._make_method(config, given)
        different = [name for name in evidence_differences(self.config, config) if name != "point_segments.method"]
        if method.name != self.method.name:
            different.append("point_segments.method")
        if different:
            raise ValueError(f"config: stored evidence depends on {', '.join(different)}; add the frames again")
        other = JointSegmenter(
            config,
            method=self._make_method,
            boundary=modules.boundary,
            image_segmenter=modules.segmenter,
            merge_within=self.merge_within,
            memory=self._memory,
            spill=self._spill,
        )
        other._given, other._method, other._cloud = given, method, cloud
        other._state = self.state + self._no_evidence(Observations())  # a copy
        return other

    def _no_evidence(self, observations: Observations) -> JointState:
        graph = self.cloud.graph
        return JointState.empty(graph.edge_index.shape[1], graph.num_points, observations)

    def _new_check(self, name: str = "") -> PoseCheck:
        graph = self.cloud.graph
        return PoseCheck(
            Cloud(graph.points, graph.colors), graph.spacing, self.config.visibility, self.cloud.local, name
        )
