"""Step 6, method paper: Felzenszwalb-Huttenlocher on the point graph, with the weights of eq. 3-6.

This is the method exactly as in the paper. Its own parameters are in stage ``paper``.
"""

from torch import Tensor

from torchjoint import ops
from torchjoint.cloud.edge_weights import EdgeWeights, discounted_angle, geometric_weights
from torchjoint.cloud.graph import PointGraph, build_point_graph, orient_normals
from torchjoint.cloud.local import LocalFrame, local_cloud
from torchjoint.config import Config
from torchjoint.scene import Cloud
from torchjoint.views.evidence import Evidence
from torchjoint.views.propagation import disagreement


def prepare(cloud: Cloud, config: Config, merge_within: float) -> PointGraph:
    """The graph of the nearest neighbours, with normals (eq. 3)."""
    frame = LocalFrame.of(cloud.points)
    local, of_cloud = local_cloud(cloud, frame, merge_within)
    return build_point_graph(local, config.point_graph.neighbors, config.paper.normal_neighbors).of(frame, of_cloud)


def segment(graph: PointGraph, evidence: Evidence, config: Config) -> Tensor:
    """Felzenszwalb-Huttenlocher with weights w_d |p_i - p_j| + w_theta theta + w_r r."""
    own = config.paper
    normals, oriented = orient_normals(graph, evidence.facing)
    terms = EdgeWeights(discounted_angle(own.convex_factor), 1.0, own.distance_weight, own.color_weight)
    weights = geometric_weights(graph.points, graph.edge_index, normals, oriented, terms, graph.colors)
    if evidence.observations and own.weight > 0:
        num_images = len(evidence.observations) if own.normalization == "all" else None
        r = disagreement(evidence.views, evidence.overlap_sum, own.overlap_threshold, num_images)
        weights = weights + own.weight * r
    return ops.felzenszwalb(graph.edge_index, weights, graph.num_points, own.scale, own.min_size)
