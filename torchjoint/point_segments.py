"""Step 6: the segments of the points, from the geometry of the cloud and what the images say about its edges."""

from __future__ import annotations

import torch
from torch import Tensor

from torchjoint import ops
from torchjoint.borders import absorb, crease_costs, merge, with_images
from torchjoint.bridges import bridge
from torchjoint.config import Config
from torchjoint.confirmation import best_overlaps
from torchjoint.pieces import piece_disagreement
from torchjoint.point_graph import PointGraph, geometric_weights, orient_normals
from torchjoint.propagation import disagreement
from torchjoint.regions import one_sided_planes, small_regions
from torchjoint.state import JointState
from torchjoint.sweep_segments import segment_sweep


def segment_points(graph: PointGraph, state: JointState, config: Config) -> Tensor:
    """Segments of the points, by the method that the config names.

    Returns:
        [N] int64 labels 0, 1, ...
    """
    if config.point_segments.method == "sweep":
        return segment_sweep(graph.points, config.sweep)
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
    """Points merge across the weakest border of all, again and again; images must then confirm what is small.

    On the way there, when they are small pieces, images have a second look at these.
    """
    region = small_regions(graph, normals, oriented, config.regions)
    planes = one_sided_planes(graph, region, normals)
    crease = crease_costs(graph.edge_index, planes, oriented, config.point_graph.convex_factor)
    borders, piece = config.borders, torch.arange(graph.num_points)
    if r is None:  # there is nothing to look through, and nothing to confirm by
        return merge(piece, graph.edge_index, crease, borders.threshold, borders.min_size)
    cost = with_images(crease, r, config.propagation.weight, borders.agreement)
    if config.pieces.threshold is not None:
        piece = merge(piece, graph.edge_index, cost, config.pieces.threshold, config.pieces.min_size)
        r = (r + piece_disagreement(piece, graph.edge_index, state.observations, config.propagation)) / 2
        cost = with_images(crease, r, config.propagation.weight, borders.agreement)
    segment = merge(piece, graph.edge_index, cost, borders.threshold, borders.min_size)
    segment = bridge(segment, planes, state.observations, config.bridges)
    if config.confirmation.min_size == 0:
        return segment
    confirmed = best_overlaps(segment, state.observations) >= config.confirmation.overlap
    return absorb(segment, graph.edge_index, cost, confirmed, config.confirmation.min_size)
