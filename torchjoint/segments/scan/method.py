"""Step 6, method scan: segments one scan of a LiDAR into ground and objects, without images."""

from __future__ import annotations

from typing import Literal

from torch import Tensor

from torchjoint.cloud.graph import PointGraph, build_edgeless_graph
from torchjoint.cloud.local import LocalFrame
from torchjoint.cloud.prepared import local_cloud
from torchjoint.config import Config
from torchjoint.scene import Cloud
from torchjoint.segments.scan.one_view import look_for_scan
from torchjoint.segments.scan.recognition import Rings
from torchjoint.segments.scan.scan_segments import segment_scan
from torchjoint.views.evidence import Evidence


def prepare(cloud: Cloud, config: Config, merge_within: float) -> PointGraph:
    """The points alone, in the given coordinates, because the sensor is at the origin. Merges only copies."""
    world = LocalFrame.of_world()
    local, of_cloud = local_cloud(cloud.with_telling_colors(), world)
    return build_edgeless_graph(local).of(world, of_cloud)


def segment(
    graph: PointGraph, evidence: Evidence, config: Config, rings: Rings | Literal["search"] | None = "search"
) -> Tensor:
    """Labels [N] int64 of the ground and of the objects on it; `rings` as for :func:`segment_scan`."""
    return segment_scan(graph.points, config.scan, rings)


def measured(graph: PointGraph) -> str:
    """The rings of the scan, or how sure it is that it is one."""
    return str(look_for_scan(graph.points))
