"""Step 6: the segments of the points, from the geometry of the cloud and what the images say about its edges."""

from __future__ import annotations

import torch
from torch import Tensor

from torchjoint import ops
from torchjoint.config import Config
from torchjoint.points.edge_costs import crease_costs, with_images
from torchjoint.points.edge_weights import geometric_weights
from torchjoint.points.graph import PointGraph
from torchjoint.points.image_support import best_overlaps
from torchjoint.points.lidar.scan_segments import segment_scan
from torchjoint.points.occlusion_bridging import bridge
from torchjoint.points.orientation import orient_normals
from torchjoint.points.pieces import piece_disagreement
from torchjoint.points.region_merging import absorb, merge
from torchjoint.points.regions import one_sided_planes, small_regions
from torchjoint.views.propagation import disagreement
from torchjoint.views.state import JointState


def segment_points(graph: PointGraph, state: JointState, config: Config) -> Tensor:
    """Segments of the points, by the method that the config names.

    Returns:
        [N] int64 labels 0, 1, ...
    """
    if config.point_segments.method == "scan":
        return segment_scan(graph.points, config.scan)
    normals, oriented = orient_normals(graph, state.facing)
    r = None
    if state.observations and config.propagation.weight > 0:
        r = disagreement(state.views, state.overlap_sum, len(state.observations), config.propagation)
    methods = {"edges": by_edges, "regions": by_regions}
    return methods[config.point_segments.method](graph, normals, oriented, r, state, config)


def by_edges(
    graph: PointGraph, normals: Tensor, oriented: Tensor, r: Tensor | None, state: JointState, config: Config
) -> Tensor:
    """As in the paper: Felzenszwalb-Huttenlocher, edges weighing w_d |p_i - p_j| + w_theta theta + w_r r (eq. 3)."""
    weights = geometric_weights(graph.points, graph.edge_index, normals, oriented, config.point_graph, graph.colors)
    if r is not None:
        weights = weights + config.propagation.weight * r
    segments = config.point_segments
    return ops.felzenszwalb(graph.edge_index, weights, graph.num_points, segments.scale, segments.min_size)


def by_regions(
    graph: PointGraph, normals: Tensor, oriented: Tensor, r: Tensor | None, state: JointState, config: Config
) -> Tensor:
    """Repeatedly merges the two regions with the lowest mean boundary cost; small segments then need support.

    Merging starts from single points. Where there are images, they compare the small pieces that appear on the way
    once more; segments that an occluder cuts in two are joined; and a small segment stays only if an image has a
    segment of its shape.
    """
    region = small_regions(graph, normals, oriented, config.regions)
    planes = one_sided_planes(graph, region, normals)
    crease = crease_costs(graph.edge_index, planes, oriented, config.point_graph.convex_factor)
    merging, piece = config.region_merging, torch.arange(graph.num_points)
    if r is None:  # no image has a say
        return merge(piece, graph.edge_index, crease, merging.threshold, merging.min_size)
    cost = with_images(crease, r, config.propagation.weight, merging.agreement)
    if config.pieces.threshold is not None:
        piece = merge(piece, graph.edge_index, cost, config.pieces.threshold, config.pieces.min_size)
        r = (r + piece_disagreement(piece, graph.edge_index, state.observations, config.propagation)) / 2
        cost = with_images(crease, r, config.propagation.weight, merging.agreement)
    segment = merge(piece, graph.edge_index, cost, merging.threshold, merging.min_size)
    segment = bridge(segment, planes, state.observations, config.occlusion_bridging)
    support = config.image_support
    if support.min_size == 0:
        return segment
    supported = best_overlaps(segment, state.observations) >= support.overlap
    return absorb(segment, graph.edge_index, cost, supported, support.min_size)
