"""Step 7: the 3D labels merge and split the segments of an image."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import torch
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from torch import Tensor

from torchjoint import ops
from torchjoint.config import ImageGraphConfig, RefinementConfig
from torchjoint.joint_labels import look_up, starts_group
from torchjoint.visibility import Visible


class PixelPairs(NamedTuple):
    """E^R, counted: pairs of visible points that are close in the image, by what their ends belong to (eq. 7-9).

    A pair is internal if both 3D labels are one, else external. Internal pairs inside one image segment, which is
    most of all pairs, play no role in what follows and are not counted; nor are pairs within one pixel, which no cut
    can part, and points outside all segments.
    """

    low_segment: Tensor  #: [G] int64; groups are sorted by this, then by the following
    high_segment: Tensor  #: [G] int64
    low_label: Tensor  #: [G] int64, 3D labels of the ends; which end is in which segment does not matter
    high_label: Tensor  #: [G] int64
    num_pairs: Tensor  #: [G] int64

    def select(self, mask: Tensor) -> PixelPairs:
        """The groups where `mask` [G] is True."""
        return PixelPairs(*(values[mask] for values in self))


def pixel_pairs(visible: Visible, segment: Tensor, point_labels: Tensor, width: int, radius: float) -> PixelPairs:
    """Counts the pairs of visible points at most `radius` pixels apart (eq. 7-9).

    Args:
        segment: [M] int64, image segment that each visible point falls in, -1 = none.
        point_labels: [M] int64, 3D label of each visible point.
        width: of the image.
    """
    pixel = visible.row * width + visible.column
    group, num_pairs = ops.pair_counts(visible.u, visible.v, pixel, segment, point_labels, radius)
    return PixelPairs(group[0], group[1], group[2], group[3], num_pairs)


def merge_segments(labels: Tensor, visible: Visible, point_labels: Tensor, config: RefinementConfig) -> Tensor:
    """Merges image segments that the 3D labels hold together (eq. 10-12).

    Over the point pairs whose ends fall in two different segments (unordered), n_R counts all and n_int the internal
    ones; the two merge when n_R > 0 and n_int / n_R >= r_m. One shot, on the segments as they come.

    Args:
        labels: [H, W] int32, -1 = none (never merged).
        point_labels: [M] int64, 3D label of each visible point.

    Returns:
        [H, W] int32; a merged segment has the lowest of its labels.
    """
    if config.merge_ratio is None:
        return labels
    segment = labels[visible.row, visible.column].long()
    pairs = pixel_pairs(visible, segment, point_labels, labels.shape[1], config.radius)
    pairs = pairs.select(pairs.low_segment != pairs.high_segment)
    if not pairs.num_pairs.numel():
        return labels
    num_labels = int(labels.max()) + 1
    keys, of_key = torch.unique(pairs.low_segment * num_labels + pairs.high_segment, return_inverse=True)
    internal = pairs.num_pairs * (pairs.low_label == pairs.high_label)
    n_all, n_internal = (torch.zeros_like(keys).index_add(0, of_key, counts) for counts in (pairs.num_pairs, internal))
    merging = keys[n_internal / n_all >= config.merge_ratio]
    graph = coo_matrix((torch.ones(len(merging)), (merging // num_labels, merging % num_labels)), (num_labels,) * 2)
    _, component = connected_components(graph, directed=False)
    component = torch.from_numpy(component).long()
    lowest = torch.full((num_labels,), num_labels).scatter_reduce(0, component, torch.arange(num_labels), "amin")
    return look_up(lowest[component].to(labels.dtype), labels, -1)


def split_segments(
    labels: Tensor,
    colors: Tensor,
    boundary: Tensor,
    visible: Visible,
    point_labels: Tensor,
    config: RefinementConfig,
    graph: ImageGraphConfig,
) -> Tensor:
    """Cuts image segments in which different 3D labels meet (eq. 13-14), and cuts the parts again.

    A segment is cut when at least n_s external pairs lie wholly inside it (pairs within one pixel cannot be cut apart
    and do not count): between the two 3D labels A, B that most of those pairs join (ties: the lowest), with the pixels
    that A's points hit as source and B's as sink, by a minimum cut of the segment's own pixel graph.

    Args:
        labels: [H, W] int32, -1 = none (never cut).
        colors: [3, H, W] RGB in [0, 1], as eq. 2 sees them (smoothed, if at all).
        boundary: [H, W] in [0, 1].
        point_labels: [M] int64, 3D label of each visible point.
        graph: weights of eq. 2.

    Returns:
        [H, W] int32; the sink's side of a cut gets a new label.
    """
    if config.split_min_edges is None:
        return labels
    labels = labels.clone(memory_format=torch.contiguous_format)
    pixel = visible.row * labels.shape[1] + visible.column
    segment = labels.view(-1)[pixel].long()
    next_label = int(labels.max()) + 1 if labels.numel() else 0
    for _ in range(config.max_splits):
        pairs = pixel_pairs(visible, segment, point_labels, labels.shape[1], config.radius)
        chosen = _label_pairs(pairs, config.split_min_edges)
        source, sink = _seeds(segment, pixel, point_labels, chosen, labels)
        on_sink_side = _cut(labels, colors, boundary, source, sink, graph)
        if not on_sink_side.numel():
            break
        cut, renamed = torch.unique(labels.view(-1)[on_sink_side], return_inverse=True)
        labels.view(-1)[on_sink_side] = (next_label + renamed).to(labels.dtype)
        # Nothing has changed but in the parts of what was cut: nothing else can be cut in the next round.
        changed = torch.zeros(next_label + len(cut) + 1, dtype=torch.bool)
        changed[cut] = True
        changed[next_label:-1] = True
        segment = labels.view(-1)[pixel].long()
        segment = torch.where(changed[segment], segment, -1)
        next_label += len(cut)
    return labels


def _label_pairs(pairs: PixelPairs, min_edges: int) -> Tensor:
    """The two 3D labels to cut each segment between: [3, C] int64, rows segment, A, B with A < B (eq. 13)."""
    inside = pairs.select(pairs.low_segment == pairs.high_segment)
    segments, of_segment = torch.unique(inside.low_segment, return_inverse=True)
    total = torch.zeros_like(segments).index_add(0, of_segment, inside.num_pairs)
    # Groups are sorted by (segment, A, B): a stable sort by falling count leaves the lowest pair first among ties.
    order = torch.argsort(inside.num_pairs, descending=True, stable=True)
    order = order[torch.argsort(of_segment[order], stable=True)]
    best = order[starts_group(of_segment[order])][total >= min_edges]
    return torch.stack([inside.low_segment, inside.low_label, inside.high_label])[:, best]


def _seeds(
    segment: Tensor, pixel: Tensor, point_labels: Tensor, chosen: Tensor, labels: Tensor
) -> tuple[Tensor, Tensor]:
    """Pixels (row x W + column) that only A's, and only B's, points hit in the segments to be cut."""
    label_a = torch.full((int(labels.max()) + 2,), -1)  # the last entry serves points without a segment
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
    """Pixels on the sink's side of a minimum cut of every segment that has both kinds of seeds.

    Capacities are exp(-w / sigma), sigma the mean of w over the segment's own edges (eq. 14).
    """
    segment = labels.view(-1)
    has_source, has_sink = torch.zeros(2, int(labels.max()) + 1, dtype=torch.bool)
    has_source[segment[source]] = True
    has_sink[segment[sink]] = True
    active = has_source & has_sink
    if not active.any():
        return source[:0]
    # A segment of one exact colour has sigma 0 and all w 0: every edge then costs the same, 1.
    pixel, node_ptr, edge_index, edge_ptr, w_over_sigma = ops.segment_graphs(
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
    """What lies between each number and the next."""
    return [slice(start, end) for start, end in pairwise(ptr.tolist())]
