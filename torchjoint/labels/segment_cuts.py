"""Step 7, method cuts: 3D labels split the segments of an image by minimum cuts (eq. 13-14)."""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor

from torchjoint import ops
from torchjoint.config import ImageGraphConfig, PaperConfig
from torchjoint.labels.pixel_pairs import RADIUS, PixelPairs, pixel_pairs
from torchjoint.ops.internal import segment_graphs
from torchjoint.runtime.sorted_groups import starts_group
from torchjoint.views.visibility import Visible

#: Largest number of rounds. Each round cuts a segment, or a part of one, in two; so a segment gets at most 256 parts.
MAX_SPLITS = 8


def split_segments(
    labels: Tensor,
    colors: Tensor,
    boundary: Tensor,
    visible: Visible,
    point_labels: Tensor,
    config: PaperConfig,
    graph: ImageGraphConfig,
) -> Tensor:
    """Cuts image segments that contain different 3D labels in two (eq. 13-14), and cuts the parts again.

    A segment is cut if at least n_s external pairs lie completely inside it. Pairs within one pixel do not count,
    because no cut can separate them. Let A, B be the two 3D labels that most of these pairs connect (ties: the lowest).
    The pixels with points of A are the source, the pixels with points of B the sink. The cut is a minimum cut of the
    segment's pixel graph.

    Args:
        labels: [H, W] int32, -1 = none (never cut).
        colors: [3, H, W] RGB in [0, 1], smoothed as for eq. 2.
        boundary: [H, W] in [0, 1].
        visible: M visible points.
        point_labels: [M] int64, 3D label of each visible point.
        config: n_s.
        graph: weights of eq. 2.

    Returns:
        [H, W] int32; the sink side of a cut gets a new label.
    """
    if config.split_min_edges is None:
        return labels
    labels = labels.clone(memory_format=torch.contiguous_format)
    pixel = visible.row * labels.shape[1] + visible.column
    segment = labels.view(-1)[pixel].long()
    next_label = int(labels.max()) + 1 if labels.numel() else 0
    for _ in range(MAX_SPLITS):
        pairs = pixel_pairs(visible, segment, point_labels, labels.shape[1], RADIUS)
        chosen = _label_pairs(pairs, config.split_min_edges)
        source, sink = _seeds(segment, pixel, point_labels, chosen, labels)
        on_sink_side = _cut(labels, colors, boundary, source, sink, graph)
        if not on_sink_side.numel():
            break
        cut, renamed = torch.unique(labels.view(-1)[on_sink_side], return_inverse=True)
        labels.view(-1)[on_sink_side] = (next_label + renamed).to(labels.dtype)
        # Only the parts of segments that were cut have changed, so only these parts can be cut in the next round.
        changed = torch.zeros(next_label + len(cut) + 1, dtype=torch.bool)
        changed[cut] = True
        changed[next_label:-1] = True
        segment = labels.view(-1)[pixel].long()
        segment = torch.where(changed[segment], segment, -1)
        next_label += len(cut)
    return labels


def _label_pairs(pairs: PixelPairs, min_edges: int) -> Tensor:
    """The two 3D labels between which each segment is cut: [3, C] int64, rows segment, A, B with A < B (eq. 13)."""
    inside = pairs.select(pairs.low_segment == pairs.high_segment)
    segments, of_segment = torch.unique(inside.low_segment, return_inverse=True)
    total = torch.zeros_like(segments).index_add(0, of_segment, inside.num_pairs)
    # Groups are sorted by (segment, A, B): after a stable sort by descending count, ties have the lowest pair first.
    order = torch.argsort(inside.num_pairs, descending=True, stable=True)
    order = order[torch.argsort(of_segment[order], stable=True)]
    best = order[starts_group(of_segment[order])][total >= min_edges]
    return torch.stack([inside.low_segment, inside.low_label, inside.high_label])[:, best]


def _seeds(
    segment: Tensor, pixel: Tensor, point_labels: Tensor, chosen: Tensor, labels: Tensor
) -> tuple[Tensor, Tensor]:
    """The seed pixels (row x W + column) in the segments to cut: those with points of A but not B, and vice versa."""
    label_a = torch.full((int(labels.max()) + 2,), -1)  # the last entry is for points without a segment
    label_b = label_a.clone()
    label_a[chosen[0]], label_b[chosen[0]] = chosen[1], chosen[2]
    at_a, at_b = pixel[point_labels == label_a[segment]], pixel[point_labels == label_b[segment]]
    hit_a, hit_b = torch.zeros(2, labels.numel(), dtype=torch.bool)
    hit_a[at_a] = True
    hit_b[at_b] = True
    return at_a[~hit_b[at_a]], at_b[~hit_a[at_b]]


def _cut(
    labels: Tensor, colors: Tensor, boundary: Tensor, source: Tensor, sink: Tensor, graph: ImageGraphConfig
) -> Tensor:
    """The pixels on the sink side of a minimum cut of every segment that has seeds of both kinds.

    Capacities are exp(-w / sigma), where sigma is the mean of w over the segment's edges (eq. 14).
    """
    segment = labels.view(-1)
    has_source, has_sink = torch.zeros(2, int(labels.max()) + 1, dtype=torch.bool)
    has_source[segment[source]] = True
    has_sink[segment[sink]] = True
    active = has_source & has_sink
    if not active.any():
        return source[:0]
    # In a segment of one exact colour, sigma and all w are 0: then every edge has the same capacity, 1.
    pixel, node_ptr, edge_index, edge_ptr, w_over_sigma = segment_graphs(
        labels, active, colors, boundary, graph.color_weight, graph.boundary_weight
    )
    capacity = torch.exp(-w_over_sigma)
    seed = torch.zeros_like(segment, dtype=torch.int64)
    seed[source], seed[sink] = 1, 2
    terminals = torch.tensor([[0, torch.inf, 0], [0, 0, torch.inf]], dtype=torch.float64)[:, seed[pixel]]
    sides = [
        ops.min_cut(edge_index[:, edges], capacity[edges], *terminals[:, nodes])[0]
        for nodes, edges in zip(_slices(node_ptr), _slices(edge_ptr), strict=True)
    ]
    return pixel[~torch.cat(sides)]


def _slices(ptr: Tensor) -> list[slice]:
    """The slices between consecutive numbers of `ptr`."""
    return [slice(start, end) for start, end in pairwise(ptr.tolist())]
