"""The joint segmentation of a point cloud and its images: Algorithm 1 of the paper.

M. Abello, J. Mangelson, M. Kaess, "A Graph-Based Method for Joint Instance Segmentation of Point Clouds and Image
Sequences", ICRA 2021. A run is a fold over the frames, because evidence is a sum::

    graph, method = prepare(cloud, config)                               # step 3
    evidence = Evidence.empty(graph)
    for batch in batches_of_frames:
        evidence += observe(batch, graph, config, image_segmenter, stopwatch)  # steps 1, 2, 4, 5
    tree = method.segment(graph, evidence, config)                       # step 6
    result = label(tree, graph, evidence, config, stopwatch)             # steps 7, 8
"""

from __future__ import annotations

import logging
import math
import warnings
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextvars import copy_context
from copy import copy
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import torch
from torch import Tensor, nn
from tqdm import tqdm

from torchjoint.cloud.graph import PointGraph
from torchjoint.cloud.local import warn_of_rounding, without_copies
from torchjoint.config import Config, evidence_differences
from torchjoint.images.segmenter import ImageSegmenter, brightened
from torchjoint.labels.label import label
from torchjoint.runtime.memory import as_bytes
from torchjoint.runtime.messages import Stopwatch, advance
from torchjoint.runtime.threads import ahead, on_cpu, one_thread_per_operation, parallel_map
from torchjoint.scene import Cloud, Frame, Scene, Segmentation
from torchjoint.scene.checks import kept_points
from torchjoint.scene.hierarchy import check_granularity
from torchjoint.segments.method import Method, choose_method, describe, tell_unread
from torchjoint.views.evidence import Evidence, FrameEvidence, observe_frame
from torchjoint.views.observations import Observations
from torchjoint.views.pose_check import PoseCheck, frames_to_check

logger = logging.getLogger(__name__)
T = TypeVar("T")


def prepare(
    cloud: Cloud, config: Config, merge_within: float = 0.0, method: Method | None = None
) -> tuple[PointGraph, Method]:
    """Step 3: the graph of a cloud, and the method of step 6 that made it.

    Its points are the distinct ones, perhaps thinned, in an order of their own; `of_given` [G] has the point of each of
    the G given ones. Nothing after it renumbers points, until :func:`~torchjoint.labels.label.label` goes back.

    Args:
        cloud: G points.
        config: all parameters.
        merge_within: metres; the points in one cube with this side are merged to their mean; 0: only copies.
        method: default: the one that the config names.
    """
    distinct, distinct_of_given = without_copies(cloud)
    method = method or choose_method(config, distinct.points)
    graph = method.prepare(distinct, config, merge_within)
    if len(graph.of_given) != len(distinct.points):
        told = f"method: {method.name}.prepare gave a graph of {len(graph.of_given)} points"
        raise ValueError(f"{told}, expected its `of_given` of {len(distinct.points)}; see PointGraph.of")
    # The method knows the distinct points only.
    return graph if distinct_of_given is None else graph.of(graph.local, graph.of_given[distinct_of_given]), method


def brightened_frame(frame: Frame, graph: PointGraph | None = None) -> Frame:
    """The frame as all steps see it: brightened if it is dark, for method learned, whose graphs have scales."""
    if graph is not None and graph.scales is None:
        return frame
    image = brightened(frame.image)
    return frame if image is frame.image else replace(frame, image=image)


@torch.no_grad()
@one_thread_per_operation()
def observe(
    frames: Sequence[Frame], graph: PointGraph, config: Config, image_segmenter: ImageSegmenter, stopwatch: Stopwatch
) -> list[FrameEvidence]:
    """Steps 1, 2, 4 and 5: the evidence of frames, which :class:`Evidence` adds up.

    Args:
        frames: those that follow each other and have one size are a batch for the image modules.
        graph: of the cloud.
        config: all parameters.
        image_segmenter: steps 1 and 2.
        stopwatch: records the seconds of the steps.
    """
    frames = parallel_map(lambda frame: brightened_frame(frame, graph), frames)
    batches = [list(batch) for _, batch in groupby(frames, key=lambda frame: frame.size)]
    segments = [of_frame for batch in batches for of_frame in image_segmenter(batch, stopwatch)]
    pairs = list(zip(frames, segments, strict=True))
    return parallel_map(lambda pair: observe_frame(*pair, graph, config, stopwatch), pairs)


class JointSegmenter(nn.Module):
    """Segments one point cloud and a sequence of posed images together.

    Call ``segmenter(scene)`` for a whole scene. Or work frame by frame: call :meth:`reset` with the cloud,
    :meth:`update` with frames in any order, and :meth:`compute` at any time. Both ways give the same labels. The labels
    do not depend on the order of the frames or on the number of threads. :meth:`merge` merges segmenters that saw
    different frames of one cloud.

    ``state_dict()`` has only parameters of your own networks. To keep the evidence, save the segmenter itself, with
    ``torch.save`` or pickle.

    Args:
        config: parameters; default ``Config()``.
        method: the method of step 6; default: the one that the config names
            (:func:`~torchjoint.segments.method.choose_method`).
        boundary: a boundary detector, [B, 3, H, W] RGB in [0, 1] -> [B, H, W] in [0, 1]; it replaces the detector
            that the config names (step 1).
        image_segmenter: any module [B, 3, H, W] -> [B, H, W] integer labels, -1 = none, or -> B
            :class:`~torchjoint.scene.Masks`; it replaces the graph segmentation of images (step 2). If a frame has
            masks or labels, they are used instead.
        merge_within: metres; the points in one cube with this side are merged to their mean, and all get its label. Use
            it for scans that overlap with small errors. Method scan ignores it. Exact copies are always merged.
        granularity: level of the result, from 0 (coarse) to 1 (fine); not with method paper. Each
            result has all levels, see :meth:`torchjoint.Segmentation.at`.
        memory: largest memory of the frames' evidence for steps 6-8: "2GB", "500 MiB", or bytes. The rest is packed to
            a temporary file. The labels do not depend on it. Default: a quarter of the memory of the machine or
            container.
        offload: folder of the temporary file; default: TMPDIR or /var/tmp. The file has no name, and the system removes
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

    #: The parameters, which cannot be changed: parts were made from them.
    config: Config = property(lambda self: self._config)  # type: ignore[assignment]

    def __init__(
        self,
        config: Config | None = None,
        *,
        method: Method | None = None,
        boundary: nn.Module | None = None,
        image_segmenter: nn.Module | None = None,
        merge_within: float = 0.0,
        granularity: float = 0.5,
        memory: int | str | None = None,
        offload: str | Path | None = None,
        allow_import: bool = False,
    ) -> None:
        super().__init__()
        check_granularity(granularity)
        if method is not None and not isinstance(method, Method):
            raise TypeError(f"method: expected a torchjoint.segments.method.Method, got {type(method).__name__}")
        if config is not None and not isinstance(config, Config):
            raise TypeError(f"config: expected a Config, got {type(config).__name__}; or use from_preset('paper')")
        if not (math.isfinite(merge_within) and merge_within >= 0):
            raise ValueError(f"merge_within: expected metres >= 0, got {merge_within}")
        self.merge_within, self.granularity = merge_within, granularity
        self._memory = as_bytes(memory)
        self._offload = None if offload is None else Path(offload)
        self._config = config or Config()
        self.image_segmenter = ImageSegmenter(self.config, boundary, image_segmenter, allow_import)
        self.stopwatch = Stopwatch()
        self._own_method = method
        self._given: Tensor | None = None
        self._checksum: int | None = None  # of all points, also of beams without return
        self._method: Method | None = None
        self._graph: PointGraph | None = None
        self._pose_check: PoseCheck | None = None  # of frames that come one by one
        self._state: Evidence | None = None

    @classmethod
    def from_preset(cls, name: str) -> JointSegmenter:
        """A segmenter with one of the package's presets, such as ``"paper"``, or a YAML file.

        Raises:
            ValueError, TypeError: an unknown preset, or a bad file; the message names it.
        """
        return cls(Config.from_preset(name))

    @torch.no_grad()
    @on_cpu()
    def forward(self, scene: Scene, *, progress: bool = False, batch_size: int = 8) -> Segmentation:
        """Segments a whole scene (steps 1-8). Several threads may call it at once.

        Args:
            scene: the cloud and its frames; without frames this is plain 3D segmentation.
            progress: show progress bars.
            batch_size: number of frames that are processed at a time; meanwhile the next batch is loaded.

        Returns:
            labels of the points [N] and of the frames [H, W]; see :class:`~torchjoint.scene.Segmentation`.

        Raises:
            TypeError: `scene` is not a Scene.
            ValueError: the scene has frames, but none of them sees a point.

        Warns:
            PoseWarning: the poses or intrinsics look wrong.
        """
        # Checked first: an error forgets no frames. The copy is of this call: several threads may call one segmenter.
        scene, own = _checked(scene, batch_size), copy(self)
        self._given = self._graph = self._state = None  # one cloud at a time in memory
        for _ in own.steps(scene, progress=progress, batch_size=batch_size):
            pass
        found = own.compute(progress=progress)
        vars(self).update(vars(own))
        return found

    if TYPE_CHECKING:  # the one of nn.Module is untyped
        __call__ = forward

    @torch.no_grad()
    def steps(
        self,
        scene: Scene,
        *,
        progress: bool = False,
        batch_size: int = 8,
        resume: Callable[[Observations], Evidence | None] | None = None,
        workers: Callable[[JointSegmenter, Scene], Iterable[Evidence]] | None = None,
    ) -> Iterator[int]:
        """Steps 1 to 5 of a whole scene, batch by batch; :meth:`compute` then gives its labels.

        Args:
            scene, progress, batch_size: as for :meth:`forward`, which is this and :meth:`compute`.
            resume: gives the evidence of an interrupted run, if there is any; it uses the empty store that it gets.
            workers: give the evidence of all frames that the state of the segmenter lacks, in the frames' order;
                default: this process.

        Yields:
            the number of frames in the state, before the first batch and after each one.
        """
        checked = self._start(_checked(scene, batch_size), resume)
        rest = range(len(self.state.observations), len(scene.frames))
        batches = workers(self, scene) if workers else self._batches(scene.frames, rest, checked, batch_size)
        is_hidden = not (progress and rest.stop)
        with tqdm(desc="frames", total=rest.stop, initial=rest.start, unit="frame", disable=is_hidden) as bar:
            yield rest.start
            for seen in batches:
                with on_cpu():
                    self.state += seen
                done = len(self.state.observations)
                bar.update(done - bar.n)
                yield done

    @on_cpu()
    def _start(self, scene: Scene, resume: Callable[[Observations], Evidence | None] | None) -> dict[int, Frame]:
        """Resets to a scene's cloud, checks its poses, and resumes; gives the frames that the check has read."""
        self._reset(scene.cloud)
        if checked := frames_to_check(scene):
            check = self._new_check(scene.name)
            check.check_all(checked.values())
            check.warn()
        if resume is not None:
            self.state = resume(self._store()) or self.state
        done = len(self.state.observations)
        if not done:  # an interrupted run has told it
            tell_unread(self.config, self.method)
        if done < len(scene.frames) and not self.method.uses_images:
            checked[done] = checked.get(done) or scene.frames[done]
            _warn_of_unused_inputs(checked[done], self.method)
        return checked

    def _batches(
        self, frames: Sequence[Frame], rest: range, known: dict[int, Frame], size: int
    ) -> Iterator[list[FrameEvidence]]:
        """The evidence of the frames in `rest`. Frames in `known` are taken from it and not read again."""

        def load(indices: range) -> list[Frame]:
            with self.stopwatch("load frames"):
                return parallel_map(lambda index: known.pop(index, None) or frames[index], indices)

        for batch in ahead(load, [rest[start : start + size] for start in range(0, len(rest), size)]):
            yield self._observed(batch)

    @torch.no_grad()
    @on_cpu()
    def reset(self, points: Tensor, colors: Tensor | None = None, normals: Tensor | None = None) -> None:
        """Forgets all frames, makes the method of step 6, and builds the graph of a cloud (step 3).

        Beams without return (many points at (0, 0, 0)) are left out, with a warning; their label is -1.

        Logs the measured scales and the method in one line (logger ``torchjoint.joint``, level INFO).

        Args:
            points: [N, 3] metres, world frame.
            colors: optional [N, 3] RGB in [0, 1]. Method learned uses them; if they are absent or all equal, it uses
                the colours of the frames. Method paper uses them if its color_weight is > 0.
            normals: optional [N, 3], estimated if absent or, with method learned, all equal. They are oriented to the
                cameras that see their points.

        Raises:
            ValueError, TypeError: naming the argument, what was expected and what came.
        """
        self._reset(Cloud.checked(points, colors, normals))
        tell_unread(self.config, self.method)

    def _reset(self, given: Cloud) -> None:
        self._state = self._pose_check = None  # of the cloud before: what interrupts this must not leave them
        self.stopwatch, self._checksum = Stopwatch(), zlib.crc32(given.points.contiguous().numpy().data)
        kept = kept_points(given.points, "points", "keep", "drop many").nonzero().squeeze(1)
        num_given, given = len(given.points), given if len(kept) == len(given.points) else given.selected(kept)
        with one_thread_per_operation(), self.stopwatch("point graph"):
            self._given = given.points
            graph, self._method = prepare(given, self.config, self.merge_within, self._own_method)
            self._graph = graph.of(graph.local, torch.full((num_given,), -1).index_copy_(0, kept, graph.of_given))
            if self.granularity != 0.5 and not self._method.has_levels:
                raise ValueError(f"granularity: expected 0.5, because method {self._method.name} has one level")
            if self._graph.known_spacing is not None:
                warn_of_rounding(given.points, self._graph.known_spacing)
            if logger.isEnabledFor(logging.INFO):
                logger.info(describe(given, self._graph, self._method))
        self._state = Evidence.empty(self._graph, self._store())

    def _store(self) -> Observations:
        return Observations(budget=self._memory, folder=self._offload)

    @torch.no_grad()
    @on_cpu()
    def update(self, frames: Frame | Sequence[Frame]) -> None:
        """Adds the evidence of one or several frames (steps 1, 2, 4, 5).

        The image modules process consecutive frames of the same size as one batch. A frame that is given twice counts
        twice; an interruption (Ctrl-C) may leave a part of their evidence: reset after it.

        Raises:
            RuntimeError: :meth:`reset` was not called before.
            ValueError: a boundary detector or an image segmenter returns a wrong shape or bad values.
            OSError: the temporary file (see `offload`) cannot be written. All of the frames are added, or none.

        Warns:
            PoseWarning: the poses or intrinsics look wrong. It comes after some frames, or in :meth:`compute`.
        """
        frames = [frames] if isinstance(frames, Frame) else list(frames)
        self._pose_check = self._pose_check or self._new_check()
        self._pose_check.check_incrementally(frames)
        if not self.state.observations and frames and not self.method.uses_images:
            _warn_of_unused_inputs(frames[0], self.method)
        self.state += self._observed(frames)

    def _observed(self, frames: Sequence[Frame]) -> list[FrameEvidence]:
        return observe(frames, self.graph, self.config, self.image_segmenter, self.stopwatch)

    @torch.no_grad()
    @on_cpu()
    def compute(self, *, images: bool = True, progress: bool = False, config: Config | None = None) -> Segmentation:
        """Computes the segmentation from all frames seen so far (steps 6-8); more frames may follow.

        Args:
            images: False: skip steps 7-8, which take most of the time; the result then has no label images.
            progress: show a progress bar.
            config: other parameters to try, as far as the evidence does not depend on them.

        Returns:
            labels of the points [N] and of the frames [H, W], frames in the order in which they were added. All
            methods but paper also give all other levels, see :meth:`torchjoint.Segmentation.at`.

        Raises:
            RuntimeError: :meth:`reset` was not called before.
            ValueError: there are frames, but none of them sees a point; or the evidence depends on a parameter that
                differs in `config`, which the message names.

        Warns:
            PoseWarning: the poses or intrinsics look wrong.
        """
        if config is not None and not isinstance(config, Config):
            raise TypeError(f"config: expected a Config, got {type(config).__name__}")
        graph, evidence, method = self.graph, self.state, self._method_of(config or self.config)
        if config is not None:
            tell_unread(config, method)
        config = config or self.config
        if self._pose_check is not None:
            self._pose_check.warn()
        evidence.check_seen()
        with one_thread_per_operation():
            clock = Stopwatch()  # of this result: others may follow
            clock.add(self.stopwatch.seconds)
            shown = "{l_bar}{bar}| {elapsed}"
            with clock("point segments"), tqdm(total=1, desc="points", bar_format=shown, disable=not progress) as bar:
                context = copy_context()
                context.run(advance.set, bar.update)
                tree = context.run(method.segment, graph, evidence, config)
                bar.update(1 - bar.n)
            found = label(tree, graph, evidence, config, clock, images=images, progress=progress)
        found = replace(found, cloud_checksum=self._checksum)
        return found if self.granularity == 0.5 else found.at(self.granularity)

    def _method_of(self, config: Config) -> Method:
        """The method of step 6 with another config; raises ValueError if the evidence does not fit to it."""
        method = self.method
        if config.point_segments.method != self.config.point_segments.method and self._own_method is None:
            method = choose_method(config, without_copies(Cloud(_of_reset(self._given)))[0].points)
        different = [name for name in evidence_differences(self.config, config) if name != "point_segments.method"]
        if method.name != self.method.name:
            different.append("point_segments.method")
        if different:
            raise ValueError(f"config: stored evidence depends on {', '.join(different)}; add the frames again")
        return method

    @property
    def graph(self) -> PointGraph:
        """The graph of the cloud that :meth:`reset` has prepared.

        Raises:
            RuntimeError: :meth:`reset` was not called before.
        """
        return _of_reset(self._graph)

    @property
    def method(self) -> Method:
        """The method of step 6 that :meth:`reset` has made.

        Raises:
            RuntimeError: :meth:`reset` was not called before.
        """
        return _of_reset(self._method)

    @property
    def state(self) -> Evidence:
        """The evidence collected since :meth:`reset`; set it to resume a run with the same parameters (not compared).

        It grows with further frames. What is set is copied, and does not grow with those of another segmenter.

        Raises:
            RuntimeError: :meth:`reset` was not called before.
            ValueError: (when set) the state belongs to another cloud.
        """
        return _of_reset(self._state)

    @state.setter
    def state(self, state: Evidence) -> None:
        self.state.check_cloud(state, "state")
        if state is not self._state:  # += sets what it has changed in place
            self._state = Evidence.empty(self.graph, self._store()) + state

    @on_cpu()
    def merge(self, other: JointSegmenter) -> None:
        """Adds the evidence of another segmenter, which saw other frames of the same cloud with the same config.

        Raises:
            ValueError: another config, cloud, or kind of networks, or both segmenters saw a frame of the same name.
        """
        own, came = ([type(part).__qualname__ for part in one.image_segmenter.modules()] for one in (self, other))
        if other.config != self.config or own != came:
            raise ValueError("other: expected a segmenter with the same config and networks")
        if self._graph is None or other._graph is None or not self._graph.is_same(other._graph):
            raise ValueError("other: expected a segmenter that was reset with the same points and colours")
        both = set(filter(None, self.state.observations.names)) & set(other.state.observations.names)
        if other is self or both:
            raise ValueError(f"other: expected a segmenter that saw other frames, both saw {sorted(both)[:3]}")
        self.state = self.state + other.state

    def _new_check(self, name: str = "") -> PoseCheck:
        graph = self.graph
        return PoseCheck(Cloud(graph.points, graph.colors), graph.spacing, self.config.visibility, graph.local, name)


def _checked(scene: Scene, batch_size: int) -> Scene:
    if not isinstance(scene, Scene):
        raise TypeError(f"scene: expected a Scene, got {type(scene).__name__}; make one: Scene(points, frames)")
    if not batch_size >= 1:
        raise ValueError(f"batch_size: expected at least 1 frame, got {batch_size}")
    return scene


def _of_reset(made: T | None) -> T:
    if made is None:
        raise RuntimeError("JointSegmenter: call reset(points) before update, compute or state")
    return made


def _warn_of_unused_inputs(frame: Frame, method: Method) -> None:
    """Logs that images do not affect the segments of the points; warns if frames have masks or labels for this."""
    logger.info(f"frames: method {method.name} segments the points without images; images only get the points' labels")
    if given := "masks" if frame.masks is not None else "labels" if frame.labels is not None else "":
        told = f"method {method.name} segments the points without images, so these {given} have no effect on the points"
        warnings.warn(f"{given} of frames: {told}; point_segments.method=learned uses them", stacklevel=4)
