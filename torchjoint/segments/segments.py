"""Step 6: segments the points, from the geometry of the cloud and the images' evidence for its edges."""

from __future__ import annotations

import torch
from torch import Tensor
from torchjoint_lab.regions.image_support import best_overlaps
from torchjoint_lab.regions.occlusion_bridging import bridge
from torchjoint_lab.regions.pieces import piece_disagreement

from torchjoint import ops
from torchjoint.cloud.edge_weights import geometric_weights
from torchjoint.cloud.graph import PointGraph
from torchjoint.cloud.orientation import orient_normals
from torchjoint.config import Config
from torchjoint.scene import Hierarchy
from torchjoint.segments.costs import combined_costs, crease_costs
from torchjoint.segments.learned.agglomeration import build_hierarchy
from torchjoint.segments.learned.boundary_model_file import load_boundary_model
from torchjoint.segments.learned.mask_majority import move_to_majority
from torchjoint.segments.learned.piece_graph import build_piece_graph
from torchjoint.segments.merging import join_small, merge
from torchjoint.segments.planes import SMOOTH_REGIONS, one_sided_planes, small_regions
from torchjoint.segments.scan.scan_segments import segment_scan
from torchjoint.views.propagation import disagreement
from torchjoint.views.state import JointState

#: Smallest piece, points; smaller pieces are joined to a neighbour, whatever the boundary cost. Fewer points have no
#: reliable r of their own; more loses small objects.
MIN_PIECE = 8


def segment_points(graph: PointGraph, state: JointState, config: Config) -> Tensor:
    """Segments the points by the method that the config names.

    Args:
        graph: the point graph.
        state: the evidence of the images.
        config: all parameters.

    Returns:
        [N] int64 labels 0, 1, ...

    Raises:
        ValueError: method learned, but the graph was built without scales; or method auto, which is not definite.
    """
    if config.point_segments.method == "auto":
        raise ValueError("config: expected a definite point_segments.method, got auto; see points.method.with_method")
    if config.point_segments.method == "scan":
        return segment_scan(graph.points, config.scan)
    if config.point_segments.method == "learned":
        return point_hierarchy(graph, state, config).at()
    normals, oriented = orient_normals(graph, state.facing)
    r = None
    if state.observations and config.propagation.weight > 0:
        r = disagreement(state.views, state.overlap_sum, len(state.observations), config.propagation)
    if config.point_segments.method == "edges":
        return by_edges(graph, normals, oriented, r, config)
    return by_regions(graph, normals, oriented, r, state, config)


def point_hierarchy(graph: PointGraph, state: JointState, config: Config) -> Hierarchy:
    """Method learned: all levels of the segmentation, whatever method the config names.

    Args:
        graph: the point graph.
        state: the evidence of the images.
        config: all parameters.

    Raises:
        ValueError: the graph was built without scales.
    """
    if graph.scales is None:
        raise ValueError("graph: method learned needs a graph that was built with the scales of the cloud")
    evidence = build_piece_graph(graph, graph.scales, state, config)
    hierarchy = build_hierarchy(evidence, load_boundary_model())
    if evidence.masks is None:
        return hierarchy
    return move_to_majority(hierarchy, graph.edge_index, evidence.masks, state.observations)


def by_edges(graph: PointGraph, normals: Tensor, oriented: Tensor, r: Tensor | None, config: Config) -> Tensor:
    """Method edges, as in the paper: Felzenszwalb-Huttenlocher with weights w_d |p_i - p_j| + w_theta theta + w_r r.

    Args:
        graph: the point graph.
        normals: [N, 3] unit length.
        oriented: [N] bool, whether a normal is oriented.
        r: [E] disagreement of the images (eq. 6); None: no images.
        config: all parameters.

    Returns:
        [N] int64 labels 0, 1, ... (eq. 3)
    """
    weights = geometric_weights(graph.points, graph.edge_index, normals, oriented, config.point_graph, graph.colors)
    if r is not None:
        weights = weights + config.propagation.weight * r
    segments = config.point_segments
    return ops.felzenszwalb(graph.edge_index, weights, graph.num_points, segments.scale, segments.min_size)


def by_regions(
    graph: PointGraph, normals: Tensor, oriented: Tensor, r: Tensor | None, state: JointState, config: Config
) -> Tensor:
    """Method regions: repeatedly merges the two regions with the lowest mean boundary cost.

    Merging starts from single points. With images there are three more stages. The images' evidence is computed again
    between small pieces, which merge first. Occlusion bridging joins segments that an occluder separates. Small
    segments then need support from an image.

    Args:
        graph: the point graph.
        normals: [N, 3] unit length.
        oriented: [N] bool, whether a normal is oriented.
        r: [E] disagreement of the images (eq. 6); None: no images.
        state: the evidence of the images.
        config: all parameters.

    Returns:
        [N] int64 labels 0, 1, ...
    """
    region = small_regions(graph, normals, oriented, SMOOTH_REGIONS)
    planes = one_sided_planes(graph, region, normals)
    crease = crease_costs(graph.edge_index, planes, oriented, config.point_graph.convex_factor)
    merging, piece = config.region_merging, torch.arange(graph.num_points)
    if r is None:  # no evidence from images
        return merge(piece, graph.edge_index, crease, merging.threshold, merging.min_size)
    cost = combined_costs(crease, r, config.propagation.weight, merging.agreement)
    if config.pieces.threshold is not None:
        piece = merge(piece, graph.edge_index, cost, config.pieces.threshold, MIN_PIECE)
        r = (r + piece_disagreement(piece, graph.edge_index, state.observations, config.propagation)) / 2
        cost = combined_costs(crease, r, config.propagation.weight, merging.agreement)
    segment = merge(piece, graph.edge_index, cost, merging.threshold, merging.min_size)
    segment = bridge(segment, planes, state.observations, config.occlusion_bridging)
    support = config.image_support
    if support.min_size == 0:
        return segment
    supported = best_overlaps(segment, state.observations) >= support.overlap
    return join_small(segment, graph.edge_index, cost, supported, support.min_size)
