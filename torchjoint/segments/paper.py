"""Step 6, method paper: Felzenszwalb-Huttenlocher on the point graph, with the weights of eq. 3-6."""

from __future__ import annotations

from torch import Tensor

from torchjoint import ops
from torchjoint.cloud.edge_weights import EdgeWeights, discounted_angle, geometric_weights
from torchjoint.cloud.graph import PointGraph, build_point_graph
from torchjoint.cloud.orientation import orient_normals
from torchjoint.scene import Cloud
from torchjoint.segments.method import Method
from torchjoint.views.propagation import disagreement
from torchjoint.views.state import JointState


class Paper(Method):
    """The method exactly as in the paper. Its own parameters are in stage ``paper``."""

    name = "paper"
    turned = ("paper.scale", "paper.min_size", "paper.weight")

    def build_graph(self, cloud: Cloud) -> tuple[PointGraph, None]:
        """The graph of the nearest neighbours, with normals (eq. 3)."""
        return build_point_graph(cloud, self.config.point_graph.neighbors, self.config.paper.normal_neighbors), None

    def segment(self, graph: PointGraph, state: JointState) -> Tensor:
        """Felzenszwalb-Huttenlocher with weights w_d |p_i - p_j| + w_theta theta + w_r r."""
        config = self.config.paper
        normals, oriented = orient_normals(graph, state.facing)
        terms = EdgeWeights(discounted_angle(config.convex_factor), 1.0, config.distance_weight, config.color_weight)
        weights = geometric_weights(graph.points, graph.edge_index, normals, oriented, terms, graph.colors)
        if state.observations and config.weight > 0:
            num_images = len(state.observations) if config.normalization == "all" else None
            r = disagreement(state.views, state.overlap_sum, config.overlap_threshold, num_images)
            weights = weights + config.weight * r
        return ops.felzenszwalb(graph.edge_index, weights, graph.num_points, config.scale, config.min_size)
