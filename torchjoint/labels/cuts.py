"""Step 7, method paper: moves points between segments by minimum cuts, and merges segments of an image."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint import ops
from torchjoint.config import Config, ImageGraphConfig, PaperConfig
from torchjoint.images.contours import smooth
from torchjoint.labels.joint_ids import joint_labels, look_up
from torchjoint.ops.internal import pair_counts, segment_graphs
from torchjoint.runtime.groups import first_places, starts_group
from torchjoint.views.observations import Observation
from torchjoint.views.visibility import Visible

#: R, pixels: about the spacing of projected points in an image of 640 x 480. With a larger R it takes longer.
RADIUS = 3.0


class PixelPairs(NamedTuple):
    """Counts of E^R, the pairs of visible points that are close in the image, by segments and 3D labels (eq. 7-9).

    A pair is internal if its two 3D labels are equal, else external. Three kinds of pairs are not counted: internal
    pairs inside one image segment (most pairs; the later steps do not need them), pairs within one pixel (no cut can
    separate them), and pairs with a point outside all segments.
    """

    low_segment: Tensor  #: [G] int64, lower image segment of the two ends; groups are sorted by this, then by the next
    high_segment: Tensor  #: [G] int64, higher image segment of the two ends
    low_label: Tensor  #: [G] int64, lower 3D label of the two ends; its end may be in either segment
    high_label: Tensor  #: [G] int64, higher 3D label of the two ends
    num_pairs: Tensor  #: [G] int64, number of pairs in the group

    def select(self, mask: Tensor) -> PixelPairs:
        """The groups where `mask` [G] is True."""
        return PixelPairs(*(values[mask] for values in self))


def pixel_pairs(visible: Visible, segment: Tensor, point_labels: Tensor, width: int, radius: float) -> PixelPairs:
    """Counts the pairs of visible points at most `radius` pixels apart (eq. 7-9).

    Args:
        visible: M visible points.
        segment: [M] int64, image segment of each visible point, -1 = none.
        point_labels: [M] int64, 3D label of each visible point.
        width: width of the image, pixels.
        radius: R, pixels.
    """
    pixel = visible.row * width + visible.column
    group, num_pairs = pair_counts(visible.u, visible.v, pixel, segment, point_labels, radius)
    return PixelPairs(group[0], group[1], group[2], group[3], num_pairs)


def merge_segments(labels: Tensor, visible: Visible, point_labels: Tensor, config: PaperConfig) -> Tensor:
    """Merges image segments whose points mostly have the same 3D labels (eq. 10-12).

    For two segments (unordered), n_R is the number of point pairs with one end in each segment, and n_int the number of
    internal pairs among them. The two merge if n_R > 0 and n_int / n_R >= r_m. All pairs of segments are tested once,
    on the segments as given.

    Args:
        labels: [H, W] int32, -1 = none (never merged).
        visible: M visible points.
        point_labels: [M] int64, 3D label of each visible point.
        config: r_m.

    Returns:
        [H, W] int32; a merged segment has the lowest of its labels.
    """
    if config.merge_ratio is None:
        return labels
    segment = labels[visible.row, visible.column].long()
    pairs = pixel_pairs(visible, segment, point_labels, labels.shape[1], RADIUS)
    pairs = pairs.select(pairs.low_segment != pairs.high_segment)
    if not pairs.num_pairs.numel():
        return labels
    num_labels = int(labels.max()) + 1
    keys, of_key = torch.unique(pairs.low_segment * num_labels + pairs.high_segment, return_inverse=True)
    internal = pairs.num_pairs * (pairs.low_label == pairs.high_label)
    n_all, n_internal = (torch.zeros_like(keys).index_add(0, of_key, counts) for counts in (pairs.num_pairs, internal))
    merging = keys[n_internal.float() / n_all >= config.merge_ratio]
    component = ops.connected_components(torch.stack([merging // num_labels, merging % num_labels]), num_labels)
    return look_up(first_places(component, num_labels)[component].to(labels.dtype), labels, -1)


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
    weights = graph.color_weight, graph.boundary_weight
    pixel, node_ptr, edge_index, edge_ptr, w_over_sigma = segment_graphs(labels, active, colors, boundary, *weights)
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


def cut(seen: Observation, point_labels: Tensor, segment_sizes: Tensor, config: Config) -> tuple[Tensor, int]:
    """Refines an image as in the paper: merges and splits its segments (step 7), then labels them (step 8).

    Args:
        seen: the frame.
        point_labels: [M] int64, 3D label of each visible point.
        segment_sizes: [S] int64, number of points of each 3D segment.
        config: stage paper, and the image graph.

    Returns:
        ([H, W] int32, the next free id); labels below S are 3D segments; pixels that are -1 in the initial labels
        stay -1.
    """
    labels = merge_segments(seen.labels, seen.visible, point_labels, config.paper)
    image, boundary = seen.image.float() / 255, seen.boundary.float() / 255
    colors = smooth(image[None], config.image_graph.smoothing)[0]
    labels = split_segments(labels, colors, boundary, seen.visible, point_labels, config.paper, config.image_graph)
    return joint_labels(labels, seen.visible, point_labels, segment_sizes, segment_sizes.shape[0])
