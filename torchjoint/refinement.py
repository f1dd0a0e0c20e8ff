"""Step 7: the 3D labels merge and split the segments of an image."""

from __future__ import annotations

from typing import NamedTuple

import torch
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from torch import Tensor

from torchjoint import ops
from torchjoint.config import RefinementConfig
from torchjoint.image_graph import grid_edges
from torchjoint.joint_labels import starts_group
from torchjoint.visibility import Visible


class PixelPairs(NamedTuple):
    """E^R: pairs of visible points that are close in the image (eq. 7)."""

    first: Tensor  #: [P] int64, index into Visible
    second: Tensor  #: [P] int64
    internal: Tensor  #: [P] bool: both ends have one 3D label (eq. 8); else the pair is external (eq. 9)


def pixel_pairs(visible: Visible, point_labels: Tensor, radius: float) -> PixelPairs:
    """All pairs of visible points at most `radius` pixels apart, each once (eq. 7-9).

    Args:
        point_labels: [M] int64, 3D label of each visible point.
    """
    positions = torch.stack([visible.u, visible.v], dim=1).numpy()
    pairs = cKDTree(positions, balanced_tree=False, compact_nodes=False).query_pairs(radius, output_type="ndarray")
    first, second = torch.from_numpy(pairs).long().unbind(1)
    return PixelPairs(first, second, point_labels[first] == point_labels[second])


def merge_segments(labels: Tensor, visible: Visible, pairs: PixelPairs, merge_ratio: float) -> Tensor:
    """Merges image segments that the 3D labels hold together (eq. 10-12).

    Over the point pairs whose ends fall in two different segments (unordered), n_R counts all and n_int the internal
    ones; the two merge when n_R > 0 and n_int / n_R >= `merge_ratio`. One shot, on the segments as they come.

    Args:
        labels: [H, W] int64, -1 = none (never merged).

    Returns:
        [H, W] int64; a merged segment has the lowest of its labels.
    """
    at_point = labels[visible.row, visible.column]
    a, b = at_point[pairs.first], at_point[pairs.second]
    between = (a != b) & (a >= 0) & (b >= 0)
    if not between.any():
        return labels
    num_labels = int(labels.max()) + 1
    key = torch.minimum(a, b)[between] * num_labels + torch.maximum(a, b)[between]
    keys, group, n_all = torch.unique(key, return_inverse=True, return_counts=True)
    n_internal = torch.bincount(group, weights=pairs.internal[between].double(), minlength=keys.shape[0])
    merging = keys[n_internal / n_all >= merge_ratio]
    graph = coo_matrix((torch.ones(len(merging)), (merging // num_labels, merging % num_labels)), (num_labels,) * 2)
    _, component = connected_components(graph, directed=False)
    component = torch.from_numpy(component).long()
    lowest = torch.full((num_labels,), num_labels).scatter_reduce(0, component, torch.arange(num_labels), "amin")
    return torch.where(labels >= 0, lowest[component[labels.clamp(min=0)]], labels)


def split_segments(
    labels: Tensor,
    weights: Tensor,
    visible: Visible,
    point_labels: Tensor,
    pairs: PixelPairs,
    config: RefinementConfig,
) -> Tensor:
    """Cuts image segments in which different 3D labels meet (eq. 13-14), and cuts the parts again.

    A segment is cut when at least n_s external pairs lie wholly inside it (pairs within one pixel cannot be cut apart
    and do not count): between the two 3D labels A, B that most
    of those pairs join (ties: the lowest), with the pixels that A's points hit as source and B's as sink, by a
    minimum cut of the segment's own pixel graph. All segments of the image are cut at once: their graphs are one
    graph with as many components.

    Args:
        labels: [H, W] int64, -1 = none (never cut).
        weights: [E] of the image's :func:`grid_edges` (eq. 2).
        point_labels: [M] int64, 3D label of each visible point.

    Returns:
        [H, W] int64; the sink's side of a cut gets a new label.
    """
    if config.split_min_edges is None or not pairs.first.numel():
        return labels
    size = labels.shape
    width = size[1]
    labels = labels.reshape(-1).clone()
    edge_index = grid_edges(*size)
    pixel = visible.row * width + visible.column
    external = ~pairs.internal & (pixel[pairs.first] != pixel[pairs.second])
    first, second = pairs.first[external], pairs.second[external]
    for _ in range(config.max_splits):
        chosen = _label_pairs(labels, pixel, point_labels, first, second, config.split_min_edges)
        source, sink = _seeds(labels, pixel, point_labels, chosen)
        on_sink_side = _cut(labels, edge_index, weights, source, sink)
        if not on_sink_side.any():
            break
        _, renamed = torch.unique(labels[on_sink_side], return_inverse=True)
        labels[on_sink_side] = int(labels.max()) + 1 + renamed
    return labels.view(size)


def _label_pairs(
    labels: Tensor, pixel: Tensor, point_labels: Tensor, first: Tensor, second: Tensor, min_edges: int
) -> Tensor:
    """The two 3D labels to cut each segment between: [3, C] int64, rows segment, A, B with A < B (eq. 13)."""
    segment = labels[pixel[first]]
    inside = (segment == labels[pixel[second]]) & (segment >= 0)
    low = torch.minimum(point_labels[first], point_labels[second])[inside]
    high = torch.maximum(point_labels[first], point_labels[second])[inside]
    rows, count = torch.unique(torch.stack([segment[inside], low, high]), dim=1, return_counts=True)
    segments, of_segment = torch.unique(rows[0], return_inverse=True)
    total = torch.zeros_like(segments).scatter_add(0, of_segment, count)
    # Rows are sorted by (segment, A, B): a stable sort by falling count leaves the lowest pair first among ties.
    order = torch.argsort(count, descending=True, stable=True)
    order = order[torch.argsort(of_segment[order], stable=True)]
    best = order[starts_group(of_segment[order])]
    return rows[:, best[total >= min_edges]]


def _seeds(labels: Tensor, pixel: Tensor, point_labels: Tensor, chosen: Tensor) -> tuple[Tensor, Tensor]:
    """Pixels ([H*W] bool) that only A's, and only B's, points hit in the segments to be cut."""
    segment_a = torch.full((int(labels.max()) + 2,), -2)  # the last entry serves pixels without a segment
    segment_b = segment_a.clone()
    segment_a[chosen[0]], segment_b[chosen[0]] = chosen[1], chosen[2]
    segment = labels[pixel]
    source, sink = torch.zeros_like(labels, dtype=torch.bool), torch.zeros_like(labels, dtype=torch.bool)
    source[pixel[point_labels == segment_a[segment]]] = True
    sink[pixel[point_labels == segment_b[segment]]] = True
    return source & ~sink, sink & ~source


def _cut(labels: Tensor, edge_index: Tensor, weights: Tensor, source: Tensor, sink: Tensor) -> Tensor:
    """Pixels ([H*W] bool) on the sink's side of a minimum cut of every segment that has both kinds of seeds.

    Capacities are exp(-w / sigma), sigma the mean of w over the segment's own edges (eq. 14).
    """
    num_labels = int(labels.max()) + 1
    has_source, has_sink = (torch.zeros(num_labels + 1, dtype=torch.bool) for _ in range(2))
    has_source[labels[source]] = True
    has_sink[labels[sink]] = True
    active = has_source & has_sink
    active[-1] = False  # where label -1 points to
    if not active.any():
        return torch.zeros_like(source)
    in_active = active[labels]
    edge = torch.nonzero(in_active[edge_index[0]] & (labels[edge_index[0]] == labels[edge_index[1]])).squeeze(1)
    edge_index, weights = edge_index[:, edge], weights[edge].double()
    segment = labels[edge_index[0]]
    count = torch.bincount(segment, minlength=num_labels)
    sigma = torch.bincount(segment, weights=weights, minlength=num_labels) / count.clamp(min=1)
    # A segment of one exact colour has sigma 0 and all w 0: every edge then costs the same, 1.
    capacity = torch.exp(-torch.where(sigma[segment] > 0, weights / sigma[segment], 0.0))
    node = torch.cumsum(in_active, 0) - 1
    terminal = torch.tensor([0.0, torch.inf], dtype=torch.float64)
    source_side, _ = ops.min_cut(
        node[edge_index], capacity, terminal[source[in_active].long()], terminal[sink[in_active].long()]
    )
    on_sink_side = torch.zeros_like(source)
    on_sink_side[in_active] = ~source_side
    return on_sink_side
