"""Step 6, method scan: segments one scan of a LiDAR into ground and objects, without images."""

from __future__ import annotations

from torch import Tensor

from torchjoint.cloud.graph import PointGraph, build_edgeless_graph
from torchjoint.cloud.local import LocalFrame
from torchjoint.cloud.prepared import PreparedCloud, local_cloud
from torchjoint.config import Config
from torchjoint.scene import Cloud
from torchjoint.segments.method import Method
from torchjoint.segments.scan.one_view import Evidence, look_for_scan
from torchjoint.segments.scan.scan_segments import segment_scan
from torchjoint.views.state import JointState


class Scan(Method):
    """Method scan. Its graph has no edges and no normals, because it does not use them.

    Args:
        config: all parameters.
        evidence: what was found in the cloud; None: it is looked for when it is needed.
    """

    name = "scan"
    uses_images = False
    turned = ("scan.gap", "scan.object_height", "scan.min_size", *Method.turned)

    def __init__(self, config: Config, evidence: Evidence | None = None) -> None:
        super().__init__(config)
        self._evidence = evidence

    def build_graph(self, cloud: Cloud) -> tuple[PointGraph, None]:
        """The points alone."""
        return build_edgeless_graph(cloud), None

    def prepare(self, cloud: Cloud, merge_within: float) -> PreparedCloud:
        """Builds the graph in the given coordinates, because the sensor is at the origin. Merges only copies."""
        world = LocalFrame.of_world()
        local, of_point = local_cloud(cloud.with_telling_colors(), world)
        graph, _ = self.build_graph(local)
        return PreparedCloud(graph, world, of_point)

    def segment(self, graph: PointGraph, state: JointState) -> Tensor:
        """Labels [N] int64 of the ground and of the objects on it."""
        return segment_scan(graph.points, self.config.scan, self._evidence.rings if self._evidence else "search")

    def measured(self, graph: PointGraph) -> str:
        """The rings of the scan, or how sure it is that it is one."""
        return str(self._found(graph))

    def _found(self, graph: PointGraph) -> Evidence:
        self._evidence = self._evidence or look_for_scan(graph.points)
        return self._evidence
