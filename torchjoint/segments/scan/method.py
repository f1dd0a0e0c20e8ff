"""Step 6, method scan: segments one scan of a turning LiDAR into ground and objects, without images."""

from __future__ import annotations

from torch import Tensor

from torchjoint.cloud.graph import PointGraph, build_edgeless_graph
from torchjoint.cloud.local import LocalFrame
from torchjoint.cloud.prepared import PreparedCloud, local_cloud
from torchjoint.scene import Cloud
from torchjoint.segments.method import Method
from torchjoint.segments.scan.recognition import find_rings
from torchjoint.segments.scan.scan_segments import segment_scan
from torchjoint.views.state import JointState


class Scan(Method):
    """Method scan. Its graph has no edges and no normals, because it does not use them."""

    name = "scan"
    uses_images = False
    turned = ("scan.gap", "scan.object_height", "scan.min_size", *Method.turned)

    def build_graph(self, cloud: Cloud) -> tuple[PointGraph, None]:
        """The points and their spacing."""
        return build_edgeless_graph(cloud), None

    def prepare(self, cloud: Cloud, merge_within: float) -> PreparedCloud:
        """Builds the graph in the given coordinates, because the sensor is at the origin. Merges only copies."""
        world = LocalFrame.of_world()
        local, of_point = local_cloud(cloud.with_telling_colors(), world)
        graph, _ = self.build_graph(local)
        return PreparedCloud(graph, world, of_point)

    def segment(self, graph: PointGraph, state: JointState) -> Tensor:
        """Labels [N] int64 of the ground and of the objects on it."""
        return segment_scan(graph.points, self.config.scan)

    def measured(self, graph: PointGraph) -> str:
        """The rings of the scan."""
        rings = find_rings(graph.points)
        return f" of a turning LiDAR with about {rings.number} rings" if rings else ", no rings of a LiDAR found"
