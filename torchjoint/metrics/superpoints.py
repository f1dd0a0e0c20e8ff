"""Metrics of over-segmentations (superpoints, superpixels): leaks across true borders, and missed borders."""

from collections.abc import Sequence
from statistics import fmean

import torch
from torch import Tensor

from torchjoint.metrics.overlaps import check_integers, checked_pair, largest, overlap_tables, places
from torchjoint.runtime.groups import renumber_by_value
from torchjoint.runtime.threads import on_cpu


def achievable_segmentation_accuracy(pred: Tensor, target: Tensor | Sequence[Tensor]) -> float:
    """Share of the points with a correct label if every superpoint gets the most frequent true label of its points.

    ``ASA = 1/n sum_S max_G |S and G|`` (M.-Y. Liu et al., "Entropy Rate Superpixel Segmentation", CVPR 2011), also
    called oracle accuracy; in [0, 1], averaged over the ground truths if there are several. Void is dropped first.

    Args:
        pred: int64, any shape.
        target: int64 of the same shape, -1 = void; or a sequence of such tensors.

    Raises:
        TypeError, ValueError: as :func:`torchjoint.metrics.segmentation_covering`.

    >>> import torch
    >>> achievable_segmentation_accuracy(torch.tensor([0, 0, 0, 1]), torch.tensor([0, 0, 1, 1]))
    0.75
    """
    tables = overlap_tables(pred, target)[1]
    return fmean([_share(largest(t.count, t.pred, len(t.pred_area)), t.target_area) for t in tables])


def undersegmentation_error(pred: Tensor, target: Tensor | Sequence[Tensor]) -> float:
    """Measures how far superpoints leak out of the true regions that they touch; lower is better.

    ``UE = 1/n sum_G sum_{S meets G} min(|S and G|, |S - G|)``, the parameter-free form of P. Neubert and P. Protzel,
    "Superpixel Benchmark and Comparison" (Forum Bildverarbeitung 2012); in [0, 1], averaged over the ground truths if
    there are several. Void is dropped first. Arguments and errors: as :func:`achievable_segmentation_accuracy`.

    >>> import torch
    >>> undersegmentation_error(torch.tensor([0, 0, 0, 1]), torch.tensor([0, 0, 1, 1]))  # (1 + 1) / 4
    0.5
    """
    tables = overlap_tables(pred, target)[1]
    return fmean([_share(torch.minimum(t.count, t.pred_area[t.pred] - t.count), t.target_area) for t in tables])


@on_cpu()
def boundary_recall(
    pred: Tensor, target: Tensor | Sequence[Tensor], edge_index: Tensor, *, tolerance: int = 1
) -> float:
    """Share of the true borders that the superpoints follow.

    On a graph of the points, the border edges are the edges between different regions. A true border edge is followed
    if it is also a predicted border edge, or, with a tolerance of 1, shares a point with one; each further unit of
    tolerance allows one more edge of distance. L. Landrieu and M. Boussaha, "Point Cloud Oversegmentation with
    Graph-Structured Deep Metric Learning" (CVPR 2019), use 1. Edges at void points are dropped first. Several ground
    truths are averaged; a ground truth without borders counts as 1.

    Args:
        pred: int64 [N], or any shape of N points.
        target: int64 of the same shape, -1 = void; or a sequence of such tensors.
        edge_index: integers [2, E], E >= 1, in 0 ... N - 1; undirected edges, each given once, for example from
            :func:`torchjoint.ops.neighbor_edges`.
        tolerance: number of edges, >= 0.

    Raises:
        TypeError, ValueError: as :func:`torchjoint.metrics.segmentation_covering`; also for edges out of range or a
            negative tolerance.

    >>> import torch
    >>> chain = torch.stack([torch.arange(5), torch.arange(1, 6)])
    >>> pred, target = torch.tensor([0, 0, 0, 1, 1, 1]), torch.tensor([0, 0, 1, 1, 1, 2])
    >>> boundary_recall(pred, target, chain)  # 1-2 is next to 2-3, 4-5 is not
    0.5
    """
    pred, targets = checked_pair(pred, target)
    if not (isinstance(tolerance, int) and tolerance >= 0):
        raise ValueError(f"tolerance: expected a number of edges >= 0, got {tolerance}")
    source, sink = _checked_edges(edge_index, len(pred))
    crossing = torch.ne(*_labels_at(pred, source, sink))
    return fmean([_recall(crossing, one, source, sink, tolerance) for one in targets])


def _recall(crossing: Tensor, target: Tensor, source: Tensor, sink: Tensor, tolerance: int) -> float:
    label_source, label_sink = _labels_at(target, source, sink)
    inside = (label_source >= 0).logical_and_(label_sink >= 0)
    border = places((label_source != label_sink).logical_and_(inside))
    if len(border) == 0:
        return 1.0
    found = crossing & inside
    for _ in range(min(tolerance, len(target))):  # no path has more edges
        edges = places(found)
        reached = torch.zeros(len(target), dtype=torch.bool)
        reached[source[edges]] = reached[sink[edges]] = True
        found = (reached[source] | reached[sink]).logical_and_(inside)
    return int(found[border].sum()) / len(border)


def _labels_at(labels: Tensor, source: Tensor, sink: Tensor) -> tuple[Tensor, Tensor]:
    small = renumber_by_value(labels)[1].int()  # half the memory for random access
    return small.index_select(0, source), small.index_select(0, sink)


def _checked_edges(edge_index: Tensor, num_points: int) -> tuple[Tensor, Tensor]:
    check_integers(edge_index, "edge_index: expected an integer tensor")
    if edge_index.dim() != 2 or edge_index.shape[0] != 2 or edge_index.shape[1] == 0:
        raise ValueError(f"edge_index: expected shape [2, E] with E >= 1, got {list(edge_index.shape)}")
    edges = edge_index.to("cpu", torch.int64)
    lowest, highest = (int(one) for one in edges.aminmax())
    if lowest < 0 or highest >= num_points:
        raise ValueError(f"edge_index: expected points in 0 ... {num_points - 1}, got {lowest} ... {highest}")
    return edges[0], edges[1]


def _share(count: Tensor, area: Tensor) -> float:
    return int(count.sum()) / int(area.sum())
