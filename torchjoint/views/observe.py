"""Steps 4 and 5 for one frame: the points that it sees, and its evidence about the edges between them."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from torchjoint.cloud.graph import PointGraph
from torchjoint.cloud.orientation import orientation_votes
from torchjoint.config import Config
from torchjoint.images.segmenter import ImageSegments
from torchjoint.runtime.stopwatch import Stopwatch
from torchjoint.scene import Frame
from torchjoint.views.evidence import FrameEvidence
from torchjoint.views.observation import Observation
from torchjoint.views.occluders import lines_across
from torchjoint.views.propagation import edge_contours, edge_overlaps
from torchjoint.views.visibility import visible_points


def observe_frame(
    frame: Frame, segments: ImageSegments, graph: PointGraph, config: Config, stopwatch: Stopwatch
) -> FrameEvidence:
    """The visible points, the side of their normals, and the overlaps of eq. 5.

    If the graph has scales and the frame no masks, also contours across edges, and lines across occluders.

    Args:
        frame: image and camera.
        segments: the result of steps 1 and 2 for the frame.
        graph: the points and their edges.
        config: all parameters.
        stopwatch: records the seconds of both steps.
    """
    with stopwatch("visibility"):
        pose = graph.local.pose(frame.world_to_camera)
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
        if graph.scales is None or segments.masks is not None:
            return FrameEvidence(observation, facing, overlaps)
        contours = edge_contours(graph.adjacency, visible, boundary)
        observation = replace(observation, lines=lines_across(visible, graph.scales.noise))
    return FrameEvidence(observation, facing, overlaps, contours)


def _to_8_bits(values: Tensor) -> Tensor:
    return values.mul(255).round_().clamp_(0, 255).to(torch.uint8)
