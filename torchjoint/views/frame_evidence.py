"""Steps 4 and 5 for one frame: the points that it sees, and its evidence about the edges between them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint.cloud.orientation import orientation_votes
from torchjoint.cloud.prepared import PreparedCloud
from torchjoint.config import Config
from torchjoint.images.segmenter import ImageSegments
from torchjoint.runtime.stopwatch import Stopwatch
from torchjoint.scene import Frame
from torchjoint.views.observation import Observation
from torchjoint.views.propagation import edge_overlaps
from torchjoint.views.state import JointState
from torchjoint.views.visibility import visible_points


class FrameEvidence(NamedTuple):
    """The evidence of one frame, for a :class:`~torchjoint.views.state.JointState`."""

    observation: Observation
    facing: Tensor  #: [M] int64, votes for the signs of the visible points' normals
    overlaps: tuple[Tensor, Tensor]  #: edges [K] with both ends in view, and their overlaps (eq. 5)
    contours: tuple[Tensor, Tensor] | None = None  #: edges [K], and contours across them; method learned only


def observe(
    frame: Frame, segments: ImageSegments, cloud: PreparedCloud, config: Config, stopwatch: Stopwatch
) -> FrameEvidence:
    """The evidence that all methods use: the visible points, the side of their normals, and the overlaps of eq. 5.

    Args:
        frame: image and camera.
        segments: the result of steps 1 and 2 for the frame.
        cloud: the points and their graph.
        config: all parameters.
        stopwatch: records the seconds of both steps.
    """
    graph = cloud.graph
    with stopwatch("visibility"):
        pose = cloud.local.pose(frame.world_to_camera)
        camera = (frame.intrinsics, pose, frame.size)
        visible = visible_points(graph.points, graph.spacing, *camera, config.visibility)
        facing = orientation_votes(graph, visible.point, pose)
    image, boundary = _to_8_bits(frame.image), _to_8_bits(segments.boundary)
    with stopwatch("propagation"):
        labels = segments.labels.to(torch.int32) if segments.masks is None else segments.masks.atom
        overlaps = edge_overlaps(graph.adjacency, visible, labels, config.propagation.window)
    observation = Observation(
        frame.name, labels, visible, frame.intrinsics.float(), pose.float(), image, boundary, segments.masks
    )
    return FrameEvidence(observation, facing, overlaps)


def add_evidence(state: JointState, seen: Sequence[FrameEvidence]) -> None:
    """Adds the evidence of frames to a state, in place.

    Raises:
        OSError: the file for observations beyond the memory budget cannot be written; the state is unchanged.
    """
    state.observations.extend([frame.observation for frame in seen])  # first: the disk may be full
    for frame in seen:
        edges, overlaps = frame.overlaps
        state.views.index_add_(0, edges, torch.ones_like(edges))
        state.overlap_sum.index_add_(0, edges, overlaps)
        state.facing[frame.observation.visible.point] += frame.facing
        if frame.contours is not None:
            edges, contours = frame.contours
            state.contour_sum.index_add_(0, edges, contours.int())
            state.contour_views.index_add_(0, edges, torch.ones_like(edges, dtype=torch.int32))


def _to_8_bits(values: Tensor) -> Tensor:
    return values.mul(255).round_().clamp_(0, 255).to(torch.uint8)
