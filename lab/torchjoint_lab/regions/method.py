"""Step 6, method regions: repeatedly merges the two regions with the lowest mean boundary cost."""

from __future__ import annotations

import torch
from torch import Tensor

from torchjoint.cloud.graph import PointGraph, build_point_graph, orient_normals
from torchjoint.cloud.local import LocalFrame, local_cloud
from torchjoint.config import Config
from torchjoint.scene import Cloud
from torchjoint.segments.method import Method
from torchjoint.segments.planes import (
    combined_costs,
    crease_costs,
    one_sided_planes,
    small_regions,
)
from torchjoint.views.evidence import Evidence
from torchjoint.views.propagation import disagreement
from torchjoint_lab.regions.config import RegionsConfig
from torchjoint_lab.regions.image_support import best_overlaps
from torchjoint_lab.regions.occlusion_bridging import bridge
from torchjoint_lab.regions.small_segments import join_small, merge
from torchjoint_lab.regions.superpoints import superpoint_disagreement

#: Smallest superpoint, points; smaller superpoints are joined to a neighbour, whatever the boundary cost. Fewer points
#: have no reliable r of their own; more loses small objects.
MIN_SUPERPOINT = 8


def prepare(cloud: Cloud, config: Config, merge_within: float) -> PointGraph:
    """The graph of the nearest neighbours, with normals."""
    config, frame = _checked(config), LocalFrame.of(cloud.points)
    local, of_cloud = local_cloud(cloud, frame, merge_within)
    return build_point_graph(local, config.point_graph.neighbors, config.region_costs.normal_neighbors).of(
        frame, of_cloud
    )


def segment(graph: PointGraph, evidence: Evidence, config: Config) -> Tensor:
    """Merges points, or small superpoints of them, by the mean cost of their boundaries.

    Merging starts from single points. With images there are three more stages. The images' evidence is computed again
    between small superpoints, which merge first. Occlusion bridging joins segments that an occluder separates. Small
    segments then need support from an image.

    Args:
        graph: what :func:`prepare` returned.
        evidence: of all frames.
        config: a :class:`RegionsConfig`.

    Raises:
        TypeError: another config, which lacks the method's parameters.
    """
    config = _checked(config)
    costs, merging = config.region_costs, config.region_merging
    normals, oriented = orient_normals(graph, evidence.facing)
    planes = one_sided_planes(graph, small_regions(graph, normals, oriented), normals)
    crease = crease_costs(graph.edge_index, planes, oriented, costs.convex_factor)
    superpoint = torch.arange(graph.num_points)
    if not evidence.observations or costs.weight == 0:  # images have no say
        return merge(superpoint, graph.edge_index, crease, merging.threshold, merging.min_size)
    superpoint, cost = _superpoints(graph, crease, evidence, config)
    found = merge(superpoint, graph.edge_index, cost, merging.threshold, merging.min_size)
    found = bridge(found, planes, evidence.observations, config.occlusion_bridging)
    support = config.image_support
    if support.min_size == 0:
        return found
    supported = best_overlaps(found, evidence.observations) >= support.overlap
    return join_small(found, graph.edge_index, cost, supported, support.min_size)


def _superpoints(graph: PointGraph, crease: Tensor, evidence: Evidence, config: RegionsConfig) -> tuple[Tensor, Tensor]:
    """What merging starts from: the superpoint of each point [N], and the cost of each edge [E]."""
    costs, agreement = config.region_costs, config.region_merging.agreement
    superpoint, threshold = torch.arange(graph.num_points), config.superpoints.threshold
    r = disagreement(evidence.views, evidence.overlap_sum, costs.overlap_threshold)
    cost = combined_costs(crease, r, costs.weight, agreement)
    if threshold is None:
        return superpoint, cost
    superpoint = merge(superpoint, graph.edge_index, cost, threshold, MIN_SUPERPOINT)
    of_superpoints = superpoint_disagreement(
        superpoint, graph.edge_index, evidence.observations, costs.overlap_threshold
    )
    return superpoint, combined_costs(crease, (r + of_superpoints) / 2, costs.weight, agreement)


def _checked(config: Config) -> RegionsConfig:
    if not isinstance(config, RegionsConfig):
        raise TypeError(f"config: method regions expected a RegionsConfig, got {type(config).__name__}")
    return config


REGIONS = Method("regions", prepare, segment)
