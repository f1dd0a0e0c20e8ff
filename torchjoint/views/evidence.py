"""Steps 4 and 5: the evidence of frames about a cloud: sums over frames, and an observation per frame.

Evidence of the same cloud can be added. So frames can be distributed over processes or machines.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple, Self

import numpy as np
import torch
from torch import Tensor

from torchjoint.cloud.graph import PointGraph, orientation_votes
from torchjoint.config import Config
from torchjoint.images.segmenter import ImageSegments
from torchjoint.runtime.messages import Stopwatch
from torchjoint.scene import Frame
from torchjoint.scene.frame import to_8_bits
from torchjoint.views.observations import Observation, Observations
from torchjoint.views.occluders import lines_across
from torchjoint.views.propagation import edge_contours, edge_overlaps
from torchjoint.views.visibility import visible_points


class FrameEvidence(NamedTuple):
    """The evidence of one frame, which :class:`Evidence` adds up."""

    observation: Observation
    facing: Tensor  #: [M] int64, votes for the signs of the visible points' normals
    overlaps: tuple[Tensor, Tensor]  #: edges [K] with both ends in view, and their overlaps (eq. 5)
    contours: tuple[Tensor, Tensor] | None = None  #: edges [K], and contours across them; method learned only


@dataclass
class Evidence:
    """Sums over the frames seen so far; the sums are exact, in any order of the frames.

    Attributes:
        views: [E] int64, v of eq. 6: number of images that see both ends of an edge.
        overlap_sum: [E] float64, sum of the overlaps of eq. 5.
        facing: [N] int64: number of cameras on the side to which the point's normal points, minus the number of
            cameras on the other side.
        contour_sum: [E] int32, sum of the boundary strengths x 255 between the two ends of an edge, method learned
            only.
        contour_views: [E] int32, number of frames in this sum.
        observations: one per frame, in the order in which the frames were added.
    """

    views: Tensor
    overlap_sum: Tensor
    facing: Tensor
    contour_sum: Tensor
    contour_views: Tensor
    observations: Observations = field(default_factory=Observations)

    @classmethod
    def empty(cls, graph: PointGraph, observations: Observations | None = None) -> Evidence:
        """The evidence before the first frame. `observations`: where to keep them; default: without limit of memory."""
        return cls.zeros(graph.edge_index.shape[1], graph.num_points, observations)

    @classmethod
    def zeros(cls, num_edges: int, num_points: int, observations: Observations | None = None) -> Evidence:
        """As :meth:`empty`, for E = `num_edges` and N = `num_points`."""
        kinds = np.int64, np.float64, np.int32, np.int32
        # not torch's: without frames nothing is written into these, and they take no memory
        views, overlaps, contours, contour_views = (torch.from_numpy(np.zeros(num_edges, kind)) for kind in kinds)
        kept = Observations() if observations is None else observations
        return cls(views, overlaps, torch.zeros(num_points, dtype=torch.int64), contours, contour_views, kept)

    def check_types(self) -> None:
        """Checks evidence that was read from a file."""
        edges, points = (len(one) if isinstance(one, Tensor) and one.ndim else 0 for one in (self.views, self.facing))
        for name, expected in vars(Evidence.zeros(edges, points)).items():
            got = getattr(self, name)
            if isinstance(expected, Tensor) and (got.dtype, got.shape) != (expected.dtype, expected.shape):
                told = f"{name}: expected {list(expected.shape)} {expected.dtype}"
                raise ValueError(f"{told}, got {got.shape} {got.dtype}")
        for index in range(len(self.observations)):
            self.observations[index].check(points)

    def check_cloud(self, other: Evidence, name: str) -> None:
        """Checks that other evidence has the same numbers of points and edges; the message calls it `name`.

        Raises:
            ValueError: the two belong to different clouds.
        """
        own, came = ((one.facing.shape[0], one.views.shape[0]) for one in (self, other))
        if own != came:
            expected = f"expected a state of the same cloud ({own[0]} points, {own[1]} edges)"
            raise ValueError(f"{name}: {expected}, got {came[0]} points, {came[1]} edges")

    def check_seen(self) -> None:
        """Checks that the frames, if there are any, see the cloud."""
        count = len(self.observations)
        if count and not self.observations.see_points:
            raise ValueError(f"frames: none of the {count} images sees a point; wrong poses, axes or units?")

    def __iadd__(self, seen: Sequence[FrameEvidence] | Evidence) -> Self:
        """Adds the evidence of frames, of all or of none.

        Raises:
            OSError: the file for observations beyond the memory budget cannot be written.
            ValueError: as of :meth:`check_cloud`.
        """
        if isinstance(seen, Evidence):
            vars(self).update(vars(self + seen))
            return self
        self.observations.extend([frame.observation for frame in seen])  # first: the disk may be full
        for frame in seen:
            edges, overlaps = frame.overlaps
            self.views.index_add_(0, edges, torch.ones_like(edges))
            self.overlap_sum.index_add_(0, edges, overlaps)
            self.facing[frame.observation.visible.point] += frame.facing
            if frame.contours is not None:
                edges, contours = frame.contours
                self.contour_sum.index_add_(0, edges, contours.int())
                self.contour_views.index_add_(0, edges, torch.ones_like(edges, dtype=torch.int32))
        return self

    def __add__(self, other: Evidence) -> Evidence:
        """The evidence of the frames of both; errors as of :meth:`check_cloud`."""
        self.check_cloud(other, "other")
        return Evidence(**{name: value + getattr(other, name) for name, value in vars(self).items()})


def observe_frame(
    frame: Frame, segments: ImageSegments, graph: PointGraph, config: Config, stopwatch: Stopwatch
) -> FrameEvidence:
    """The visible points, the side of their normals, and the overlaps of eq. 5.

    If the graph has scales, also contours across edges; and lines across occluders, if the frame has no masks.

    Args:
        frame: image and camera.
        segments: the result of steps 1 and 2 for the frame.
        graph: the points and their edges.
        config: all parameters.
        stopwatch: records the seconds of both steps.
    """
    with stopwatch("visibility"):
        pose = graph.local.pose(frame.world_to_camera)
        visible = visible_points(graph.points, graph.spacing, frame.intrinsics, pose, frame.size, config.visibility)
        facing = orientation_votes(graph, visible.point, pose)
    image, boundary = to_8_bits(frame.image), to_8_bits(segments.boundary)
    with stopwatch("propagation"):
        labels = segments.labels.to(torch.int32) if segments.masks is None else segments.masks.atom
        overlaps = edge_overlaps(graph.adjacency, visible, labels, config.propagation.window)
        camera = frame.intrinsics.float(), pose.float()
        observation = Observation(frame.name, labels, visible, *camera, image, boundary, segments.masks)
        if graph.scales is None:
            return FrameEvidence(observation, facing, overlaps)
        contours = edge_contours(graph.adjacency, visible, boundary)
        if segments.masks is None:
            observation = replace(observation, lines=lines_across(visible, graph.scales.noise))
    return FrameEvidence(observation, facing, overlaps, contours)
