"""The joint segmentation of a point cloud and its images, steps 1-8: Algorithm 1 of the paper in reading order.

M. Abello, J. Mangelson, M. Kaess, "A Graph-Based Method for Joint Instance Segmentation of Point Clouds and Image
Sequences", ICRA 2021.
"""

from __future__ import annotations

import logging
import math
import warnings
from collections.abc import Iterator, Sequence
from copy import copy
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn
from tqdm import tqdm

from torchjoint.config import Config, evidence_differences
from torchjoint.datasets.lazy import LazySequence
from torchjoint.images.segmenter import ImageSegmenter, ImageSegments
from torchjoint.labels.image_labels import label_image
from torchjoint.labels.joint_ids import private_id_offsets
from torchjoint.labels.piece_images import PieceImages
from torchjoint.points.graph import PointGraph
from torchjoint.points.method import describe, with_method
from torchjoint.points.orientation import orientation_votes
from torchjoint.points.prepared_cloud import prepare_cloud
from torchjoint.points.segments import point_hierarchy, segment_points
from torchjoint.results.checkpoint import Checkpoint
from torchjoint.runtime.ahead import ahead
from torchjoint.runtime.memory import as_bytes
from torchjoint.runtime.packing import Packed, pack
from torchjoint.runtime.stopwatch import Stopwatch
from torchjoint.runtime.threads import on_cpu, one_thread_per_operation, parallel_map
from torchjoint.scene import Frame, Hierarchy, LabelImages, Scene, Segmentation
from torchjoint.scene.local_cloud import LocalFrame
from torchjoint.views.observation import Observation
from torchjoint.views.observations import Observations
from torchjoint.views.pose_check import PoseCheck, frames_to_check
from torchjoint.views.propagation import edge_contours, edge_overlaps
from torchjoint.views.state import JointState
from torchjoint.views.visibility import visible_points

logger = logging.getLogger(__name__)

_NO_CLOUD = "JointSegmenter: call reset(points) before update, compute or state"


class JointSegmenter(nn.Module):
    """Segments one point cloud and a sequence of posed images together.

    Call ``segmenter(scene)`` for a whole scene. Or work frame by frame: :meth:`reset` with the cloud, :meth:`update`
    with frames in any order, :meth:`compute` at any time. Both ways give the same labels; the labels depend neither on
    the order of the frames nor on the number of threads. Segmenters that saw different frames of one cloud can be
    merged (:meth:`merge`).

    Args:
        config: parameters; default ``Config()``.
        boundary: a boundary detector, [B, 3, H, W] RGB in [0, 1] -> [B, H, W] in [0, 1]; it replaces the detector
            that the config names (step 1).
        image_segmenter: any module [B, 3, H, W] -> [B, H, W] integer labels, -1 = none, or -> B
            :class:`~torchjoint.scene.Masks`; it replaces the graph segmentation of images (step 2). If a frame has
            masks or labels, they are used instead.
        merge_within: metres; the points in a cube with this side count as one point, their mean, and all get its label
            (not with method scan). For scans that overlap with small errors. Copies, which are equal to the last bit,
            always count as one.
        memory: how much of the frames stays in memory for steps 6-8: "2GB", "500 MiB", or bytes; what is beyond goes
            packed to a temporary file. It does not change the labels. Default: a quarter of the memory of the machine
            or container.
        spill: folder for that file, which has no name and vanishes with the process; default: TMPDIR, or /var/tmp.

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
        boundary: nn.Module | None = None,
        image_segmenter: nn.Module | None = None,
        merge_within: float = 0.0,
        memory: int | str | None = None,
        spill: str | Path | None = None,
    ) -> None:
        super().__init__()
        if config is not None and not isinstance(config, Config):
            raise TypeError(
                f"config: expected a Config, got {type(config).__name__}; see JointSegmenter.from_preset('indoor')"
            )
        if not (math.isfinite(merge_within) and merge_within >= 0):
            raise ValueError(f"merge_within: expected metres >= 0, got {merge_within}")
        self.merge_within = merge_within
        self._memory = as_bytes(memory)
        self._spill = None if spill is None else Path(spill)
        self.config = config or Config()
        self.image_segmenter = ImageSegmenter(self.config, boundary, image_segmenter)
        self.stopwatch = Stopwatch()
        self._definite = self.config  # after `reset` without "auto"
        self._graph: PointGraph | None = None
        self._of_point: Tensor | None = None  # [N] the graph's point of each given point; None = itself
        self._given: Tensor | None = None  # [M, 3] the given points without copies
        self._local = LocalFrame.of_world()  # of the graph's points
        self._check: PoseCheck | None = None  # of frames that come one by one
        self._state: JointState | None = None

    @classmethod
    def from_preset(cls, name: str) -> JointSegmenter:
        """A segmenter with one of the package's presets, e.g. ``"tabletop"`` or ``"paper"``, or a YAML file.

        Raises:
            ValueError, TypeError: an unknown preset, or a bad file; the message names it.
        """
        return cls(Config.from_preset(name))

    if TYPE_CHECKING:  # nn.Module's own would be untyped

        def __call__(
            self, scene: Scene, *, progress: bool = False, batch_size: int = 8, checkpoint: Checkpoint | None = None
        ) -> Segmentation:
            """See :meth:`forward`."""

    @torch.no_grad()
    @on_cpu()
    def forward(
        self, scene: Scene, *, progress: bool = False, batch_size: int = 8, checkpoint: Checkpoint | None = None
    ) -> Segmentation:
        """Segments a whole scene (steps 1-8).

        Args:
            scene: the cloud and its frames; without frames this is plain 3D segmentation.
            progress: show progress bars.
            batch_size: number of frames that are worked on at a time; meanwhile as many are loaded.
            checkpoint: saves the state from time to time; an interrupted run resumes from it.

        Returns:
            labels of the points [N] and of the frames [H, W]; see :class:`~torchjoint.scene.Segmentation`.

        Raises:
            TypeError: not a scene.
            ValueError: the scene has frames, but none of them sees a point.

        Warns:
            PoseWarning: the poses or intrinsics look wrong.
        """
        checked = self.begin(scene, checkpoint)
        num_frames, done = len(scene.frames), len(self.state.observations)
        with tqdm(total=num_frames, initial=done, desc="frames", unit="frame", disable=not progress) as bar:
            batches = [range(num_frames)[start : start + batch_size] for start in range(done, num_frames, batch_size)]
            for batch in ahead(lambda indices: self._load_frames(scene.frames, indices, checked), batches):
                self.add(batch)
                bar.update(len(batch))
                if checkpoint is not None:
                    checkpoint.save(self.state)
        if checkpoint is not None:
            checkpoint.save(self.state, now=True)
        return self.compute(progress=progress)

    @torch.no_grad()
    @on_cpu()
    def begin(self, scene: Scene, checkpoint: Checkpoint | None = None) -> dict[int, Frame]:
        """What comes before the frames of a scene: :meth:`reset`, the check of poses, and the state of a checkpoint.

        Returns:
            the frames that the check has read, by index.

        Raises:
            TypeError: not a scene.

        Warns:
            PoseWarning: the poses or intrinsics look wrong.
        """
        if not isinstance(scene, Scene):
            raise TypeError(f"scene: expected a Scene, got {type(scene).__name__}; of points: Scene(points, frames)")
        self.reset(scene.points, scene.colors, scene.normals)
        checked = frames_to_check(scene)
        check = self._new_check(scene.name)
        check.look_at(checked.values())
        check.warn()
        if checkpoint is not None:
            self.state = checkpoint.load(Observations(budget=self._memory, folder=self._spill)) or self.state
        return checked

    def _load_frames(self, frames: Sequence[Frame], indices: range, loaded: dict[int, Frame]) -> list[Frame]:
        """The frames at `indices`. Frames that are already in `loaded` are moved out of it instead of read again."""
        with self.stopwatch("load frames"):
            return parallel_map(lambda index: loaded.pop(index, None) or frames[index], indices)

    @torch.no_grad()
    @on_cpu()
    def reset(self, points: Tensor, colors: Tensor | None = None, normals: Tensor | None = None) -> None:
        """Forgets all frames, chooses the method of step 6 if it is auto, and builds the graph of a cloud (step 3).

        What was measured and chosen is logged in one line (logger ``torchjoint.joint``, level INFO).

        Args:
            points: [N, 3] metres, world frame.
            colors: optional [N, 3] RGB in [0, 1], used only by method learned, and by method edges with a
                color_weight > 0.
            normals: optional [N, 3], estimated if absent; a normal is turned to the cameras that see its point.

        Raises:
            ValueError, TypeError: naming the argument, what was expected and what came.
        """
        cloud = Scene(points, colors=colors, normals=normals)
        self.stopwatch = Stopwatch()
        with one_thread_per_operation(), self.stopwatch("point graph"):
            prepared = prepare_cloud(cloud, self.config, self.merge_within)
            self._graph, self._local, self._of_point, self._given, self._definite = prepared
            if logger.isEnabledFor(logging.INFO):
                logger.info(describe(len(cloud.points), self._graph, self._definite))
        observations = Observations(budget=self._memory, folder=self._spill)
        self._state = JointState.empty(self._graph.edge_index.shape[1], self._graph.num_points, observations)
        self._check = self._new_check()

    def _new_check(self, name: str = "") -> PoseCheck:
        graph = self._require_graph()
        cloud = Scene(graph.points, colors=graph.colors)
        return PoseCheck(cloud, graph.spacing, self.config.visibility, self._local, name)

    @torch.no_grad()
    @on_cpu()
    def update(self, frames: Frame | Sequence[Frame]) -> None:
        """Adds the evidence of one or several frames (steps 1, 2, 4, 5).

        Consecutive frames of the same size go through the image modules as one batch.

        Raises:
            RuntimeError: :meth:`reset` was not called before.
            ValueError: a boundary detector or an image segmenter returns a wrong shape or bad values.
            OSError: what goes beyond the memory cannot be written. The segmenter is as it was before these frames, or
                before those of the last size.

        Warns:
            PoseWarning: the poses or intrinsics look wrong, once that some frames came (or at :meth:`compute`).
        """
        frames = [frames] if isinstance(frames, Frame) else list(frames)
        if self._check is None:
            raise RuntimeError(_NO_CLOUD)
        self._check.look_as_they_come(frames)
        self.add(frames)

    @torch.no_grad()
    @on_cpu()
    def add(self, frames: Sequence[Frame]) -> None:
        """As :meth:`update`, for frames whose poses have been checked, by :meth:`begin` for example."""
        state = self.state
        if not state.observations and frames:
            self._tell_unused(frames[0])
        with one_thread_per_operation():
            for batch in _batches_of_one_size(frames):
                segments = self.image_segmenter(batch, self.stopwatch)
                seen = parallel_map(lambda item: self._observe(*item), zip(batch, segments, strict=True))
                state.observations.extend([observation for observation, *_ in seen])  # first: the disk may be full
                for observation, facing, (edges, overlaps), contours in seen:
                    state.views.index_add_(0, edges, torch.ones_like(edges))
                    state.overlap_sum.index_add_(0, edges, overlaps)
                    state.facing[observation.visible.point] += facing
                    if contours is not None:
                        state.contour_sum[contours[0]] += contours[1]
                        state.contour_views[contours[0]] += 1

    def _tell_unused(self, frame: Frame) -> None:
        """Says so if images have no say in the segments of the points."""
        if self._definite.point_segments.method != "scan":
            return
        logger.info("frames: method scan segments the points without images; images only get the points' labels")
        given = "masks" if frame.masks is not None else "labels" if frame.labels is not None else ""
        if given:
            warnings.warn(
                f"{given} of frames: method scan segments the points without images, so these {given} have no effect "
                "on the points; point_segments.method=learned uses them",
                stacklevel=3,
            )

    @torch.no_grad()
    @on_cpu()
    def compute(self, *, images: bool = True, progress: bool = False) -> Segmentation:
        """Computes the segmentation from all frames seen so far (steps 6-8); more frames may follow.

        Args:
            images: False skips the label images (steps 7-8), which take most of the time; the result then has none.
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
        state = self.state
        if self._check is not None:
            self._check.warn()
        seen, count = state.observations[:], len(state.observations)  # results keep them; more frames may follow
        if count and not seen.see_points:
            raise ValueError(f"frames: none of the {count} images sees a point; wrong poses, axes or units?")
        with one_thread_per_operation():
            with self.stopwatch("point segments"):
                given_points, point_labels, hierarchy, piece = self._segment_points()
            if not images:
                return Segmentation(given_points, (), seconds=dict(self.stopwatch.seconds), hierarchy=hierarchy)
            sizes = torch.bincount(point_labels)
            bar = tqdm(total=count, desc="images", unit="frame", disable=not progress)

            def refine(observation: Observation) -> tuple[Packed, int]:
                with self.stopwatch("image labels"):
                    refined, next_free = label_image(observation, point_labels, sizes, self.config)
                bar.update()
                return pack(refined), next_free

            with bar:
                refined = parallel_map(refine, seen)
        num_segments = len(sizes)
        offsets = private_id_offsets([next_free for _, next_free in refined], seen, num_segments)
        labels = LabelImages([image for image, _ in refined], num_segments, offsets)
        return Segmentation(
            points=given_points,
            images=labels,
            initial_images=LazySequence(count, lambda index: seen[index].initial_labels().long()),
            names=tuple(seen.names),
            seconds=dict(self.stopwatch.seconds),
            hierarchy=hierarchy,
            piece_images=()
            if hierarchy is None or piece is None
            else PieceImages(labels, seen, hierarchy, piece, self.config),
        )

    def _segment_points(self) -> tuple[Tensor, Tensor, Hierarchy | None, Tensor | None]:
        """Step 6: labels of the given points and of the graph's; if learned, all levels, and pieces of the graph's."""
        graph, state, of_point = self._require_graph(), self.state, self._of_point
        if self.method != "learned":
            labels = segment_points(graph, state, self._definite)
            return labels if of_point is None else labels[of_point], labels, None, None
        hierarchy = point_hierarchy(graph, state, self._definite)
        piece = hierarchy.piece
        if of_point is not None:
            hierarchy, number = hierarchy.transferred(of_point)
            piece = number[piece]
        return hierarchy.at(), hierarchy.segments_of_pieces(hierarchy.default)[piece], hierarchy, piece

    @property
    def state(self) -> JointState:
        """The evidence collected since :meth:`reset`; set it to resume a run.

        Raises:
            RuntimeError: :meth:`reset` was not called before.
            ValueError: (when set) the state belongs to another cloud.
        """
        if self._state is None:
            raise RuntimeError(_NO_CLOUD)
        return self._state

    @state.setter
    def state(self, state: JointState) -> None:
        if state.views.shape != self.state.views.shape or state.facing.shape != self.state.facing.shape:
            raise ValueError("state: expected the state of a segmenter that was reset with the same cloud")
        self._state = state

    @property
    def method(self) -> str:
        """Method of step 6: the config's, or, if that is auto, the one that :meth:`reset` chose."""
        return self._definite.point_segments.method

    def _require_graph(self) -> PointGraph:
        if self._graph is None:
            raise RuntimeError("JointSegmenter: call reset(points) first")
        return self._graph

    def merge(self, other: JointSegmenter) -> None:
        """Adds the evidence of another segmenter, which saw other frames of the same cloud with the same config.

        Raises:
            ValueError: another config or cloud, or both segmenters saw a frame of the same name.
        """
        if other.config != self.config:
            raise ValueError("other: expected a segmenter with the same config")
        is_same = self._graph is not None and other._graph is not None and self._graph.is_same(other._graph)
        if not (is_same and self._local.is_same(other._local)):
            raise ValueError("other: expected a segmenter that was reset with the same points")
        both = set(filter(None, self.state.observations.names)) & set(other.state.observations.names)
        if other is self or both:
            raise ValueError(f"other: expected a segmenter that saw other frames, both saw {sorted(both)[:3]}")
        self.state = self.state + other.state

    @on_cpu()
    def without_evidence(self) -> JointSegmenter:
        """A segmenter of the same cloud that has seen no frame; it shares the cloud's graph, and can be pickled.

        Raises:
            RuntimeError: :meth:`reset` was not called before.
        """
        graph, other = self._require_graph(), copy(self)
        other._state = JointState.empty(graph.edge_index.shape[1], graph.num_points)
        other._check, other.stopwatch = None, Stopwatch()
        return other

    @on_cpu()
    def with_config(self, config: Config) -> JointSegmenter:
        """A segmenter with the same evidence and other parameters: tries out parameters without seeing frames again.

        Raises:
            ValueError: the stored evidence depends on a parameter that differs; the message names the parameter.
        """
        graph = self._require_graph()
        is_decided = self.config.point_segments.method == config.point_segments.method  # from all points, if "auto"
        definite = config.replace({"point_segments": {"method": self._definite.point_segments.method}})
        if not is_decided and self._given is not None:
            definite = with_method(config, self._given.float())
        if different := evidence_differences(self._definite, definite):
            raise ValueError(f"config: what was seen depends on {', '.join(different)}; see the frames again")
        modules = self.image_segmenter
        other = JointSegmenter(
            config,
            boundary=modules.boundary,
            image_segmenter=modules.segmenter,
            merge_within=self.merge_within,
            memory=self._memory,
            spill=self._spill,
        )
        other._graph, other._definite, other._of_point = graph, definite, self._of_point
        other._local, other._given = self._local, self._given
        other._state = self.state + JointState.empty(graph.edge_index.shape[1], graph.num_points)  # a copy
        other._check = other._new_check()
        return other

    def _observe(
        self, frame: Frame, segments: ImageSegments
    ) -> tuple[Observation, Tensor, tuple[Tensor, Tensor], tuple[Tensor, Tensor] | None]:
        """Steps 4 and 5 for one frame: the observation; votes for the normals' signs; edges and their overlaps.

        For method learned also edges and the contours across them, if the frame has no masks.
        """
        graph = self._require_graph()
        with self.stopwatch("visibility"):
            pose = self._local.pose(frame.world_to_camera)
            camera = (frame.intrinsics, pose, frame.size)
            visible = visible_points(graph.points, graph.spacing, *camera, self.config.visibility)
            facing = orientation_votes(graph, visible.point, pose)
        image, boundary = _to_8_bits(frame.image), _to_8_bits(segments.boundary)
        with self.stopwatch("propagation"):
            labels = segments.labels.to(torch.int32) if segments.masks is None else segments.masks.atom
            overlaps = edge_overlaps(graph.adjacency, visible, labels, self.config.propagation.window)
            contours = None
            if self.method == "learned" and segments.masks is None:
                contours = edge_contours(graph.adjacency, graph.edge_index, visible, boundary)
        return Observation(frame.name, labels, visible, image, boundary, segments.masks), facing, overlaps, contours


def _batches_of_one_size(frames: Sequence[Frame]) -> Iterator[list[Frame]]:
    for _, batch in groupby(frames, key=lambda frame: frame.size):
        yield list(batch)


def _to_8_bits(values: Tensor) -> Tensor:
    return values.mul(255).round_().clamp_(0, 255).to(torch.uint8)
