"""Operators on weighted graphs: components, segmentation, region merging and minimum cuts (steps 6 and 7)."""

import torch
from torch import Tensor

from torchjoint.ops._call import call, of_one_size, register_fakes
from torchjoint.ops._checks import FLOATING, check_array, check_edge_index, check_num_nodes, check_number


def connected_components(edge_index: Tensor, num_nodes: int) -> Tensor:
    """Label the connected components of a graph: two nodes have the same label if a path of edges connects them.

    Args:
        edge_index: ``[2, E]`` int64, undirected edges. Self loops and repeated edges have no effect.
        num_nodes: number of nodes N, below 2^31; each takes 12 bytes of memory.

    Returns:
        ``[N]`` int64 labels 0, 1, 2, ... in the order of their first node.

    Raises:
        TypeError: an argument of the wrong type or dtype.
        ValueError: a wrong shape or device, a node number outside [0, N), a negative number.

    Example:
        >>> import torch
        >>> connected_components(torch.tensor([[3, 1], [0, 4]]), num_nodes=5)
        tensor([0, 1, 2, 0, 1])
    """
    check_edge_index(edge_index)
    check_num_nodes(num_nodes)
    return call("connected_components", edge_index, num_nodes)


def felzenszwalb(edge_index: Tensor, weight: Tensor, num_nodes: int, scale: float, min_size: int = 0) -> Tensor:
    """Segment a weighted graph: P. Felzenszwalb, D. Huttenlocher, "Efficient Graph-Based Image Segmentation".

    The edges are processed in ascending order of weight, ties in the given order. An edge of weight ``w`` between two
    components joins them if ``w <= min(Int(C1) + scale/|C1|, Int(C2) + scale/|C2|)``, where ``Int(C)`` is the largest
    weight in the minimum spanning tree of ``C`` (0 for a single node). A second pass, in the same order, joins every
    component of fewer than ``min_size`` nodes along its first edge to another component. All arithmetic is in float32,
    and the result is deterministic.

    Args:
        edge_index: ``[2, E]`` int64, undirected edges. Self loops and repeated edges have no effect.
        weight: ``[E]`` float32 or float64 (rounded to float32), the dissimilarity of the two ends. May be negative or
            infinite, but not NaN.
        num_nodes: number of nodes N, below 2^31.
        scale: the paper's k, in units of weight times nodes: larger values give larger segments.
        min_size: components of fewer nodes than this are joined to a neighbour, if they have one.

    Returns:
        ``[N]`` int64 labels 0, 1, 2, ... in the order of their first node. No gradient flows through them.

    Raises:
        TypeError: an argument of the wrong type or dtype.
        ValueError: a wrong shape or device, a node number outside [0, N), a NaN weight, a negative number.

    Example:
        >>> import torch
        >>> edge_index = torch.tensor([[0, 1, 2], [1, 2, 3]])
        >>> felzenszwalb(edge_index, torch.tensor([0.1, 5.0, 0.2]), num_nodes=4, scale=1.0)
        tensor([0, 0, 1, 1])
        >>> felzenszwalb(edge_index, torch.tensor([0.1, 5.0, 0.2]), num_nodes=4, scale=1.0, min_size=3)
        tensor([0, 0, 0, 0])
    """
    check_edge_index(edge_index)
    check_array("weight", weight, FLOATING, (edge_index.shape[1],), "[E]")
    check_num_nodes(num_nodes)
    check_number("scale", scale, (int, float))
    check_number("min_size", min_size, (int,))
    return call("felzenszwalb", edge_index, weight, num_nodes, float(scale), min_size)


def merge_regions(
    edge_index: Tensor, cost: Tensor, size: Tensor, threshold: float, min_size: int = 0, *, by_size: bool = False
) -> Tensor:
    """Repeatedly merge the two neighbouring regions with the lowest mean boundary cost, up to a threshold.

    The boundary of two regions consists of all edges between them. When two regions merge, their boundaries with the
    same third region become one boundary. Afterwards, regions smaller than ``min_size`` are merged across the boundary
    with the lowest mean, until no such region has a neighbour. This is average-linkage agglomeration (R. Sokal and C.
    Michener, 1958) of the region adjacency graph, as P. Arbeláez et al. (PAMI 2011) merge image regions. With
    ``by_size``, the mean is multiplied by a b / (a + b) for regions of sizes a and b, as in J. Ward's criterion (1963):
    small regions merge first, and large ones only across the weakest boundaries. ``min_size`` always goes by the mean.

    Costs are rounded to multiples of 2^-20, so that sums are exact (below 2^33 per boundary). Of boundaries with equal
    means, the one with the lowest number is merged first. Boundaries are numbered by their first edges; a joined
    boundary keeps the lower number.

    Args:
        edge_index: ``[2, E]`` int64, region numbers of the two ends. Edges inside a region are ignored. Parallel edges
            all count, so that the mean is over the whole boundary.
        cost: ``[E]`` float32 in [0, 1024].
        size: ``[R]`` int64, size of each region, >= 0, in any unit.
        threshold: largest mean cost of two regions that merge, >= 0; ``by_size``: in the unit of cost x size.
        min_size: smaller regions are merged with a neighbour; in the unit of ``size``.
        by_size: whether sizes count in the cost of two regions.

    Returns:
        ``[R]`` int64, for each region a label 0, 1, ..., numbered by first appearance. No gradient flows through it.

    Raises:
        TypeError: an argument of the wrong type or dtype.
        ValueError: a wrong shape or device, a number out of range, a NaN.

    Example:
        >>> import torch
        >>> edge_index = torch.tensor([[0, 0, 1, 1], [1, 1, 2, 2]])  # two borders of two edges each
        >>> merge_regions(edge_index, torch.tensor([0.0, 0.2, 0.1, 0.9]), torch.ones(3, dtype=torch.int64), 0.3)
        tensor([0, 0, 1])
    """
    check_edge_index(edge_index)
    check_array("cost", cost, torch.float32, (edge_index.shape[1],), "[E]")
    check_array("size", size, torch.int64, (None,), "[R]")
    check_number("threshold", threshold, (int, float))
    check_number("min_size", min_size, (int,))
    return call("merge_regions", edge_index, cost, size, float(threshold), min_size, bool(by_size))


def region_dendrogram(
    edge_index: Tensor, cost: Tensor, num_regions: int, threshold: float, count: Tensor | None = None
) -> tuple[Tensor, Tensor]:
    """List the merges that :func:`torchjoint.ops.merge_regions` makes up to a threshold.

    The mean costs of the merges ascend, because each merge has the lowest mean of all boundaries. The merges connect
    the same groups as ``merge_regions`` without ``min_size``. Costs are rounded, and ties are broken, in the same
    way.

    Args:
        edge_index: ``[2, E]`` int64, region numbers of the two ends. Edges inside a region are ignored. Parallel edges
            all count.
        cost: ``[E]`` float32 in [0, 1024].
        num_regions: number of regions R, < 2^31.
        threshold: largest mean cost of two regions that merge, >= 0.
        count: ``[E]`` int64, how many parallel edges each edge stands for, >= 1; None: 1.

    Returns:
        ``[2, M]`` int64, for each merge the lowest regions a < b of the two groups that merge; ``[M]`` float64, the
        mean cost of their boundary. M < R. No gradient flows through it.

    Raises:
        TypeError: an argument of the wrong type or dtype.
        ValueError: a wrong shape or device, a number out of range, a NaN.

    Example:
        >>> import torch
        >>> edge_index = torch.tensor([[0, 1, 0], [1, 2, 2]])
        >>> region_dendrogram(edge_index, torch.tensor([0.0, 0.25, 0.75]), 3, 1.0)
        (tensor([[0, 0],
                [1, 2]]), tensor([0.0000, 0.5000], dtype=torch.float64))
    """
    check_edge_index(edge_index)
    check_array("cost", cost, torch.float32, (edge_index.shape[1],), "[E]")
    check_number("num_regions", num_regions, (int,))
    check_number("threshold", threshold, (int, float))
    if count is None:
        count = edge_index.new_ones(()).expand(edge_index.shape[1])  # takes no memory
    check_array("count", count, torch.int64, (edge_index.shape[1],), "[E]")
    return call("region_dendrogram", edge_index, cost, num_regions, float(threshold), count)


def min_cut(
    edge_index: Tensor, capacity: Tensor, source_capacity: Tensor, sink_capacity: Tensor
) -> tuple[Tensor, Tensor]:
    """Compute the minimum s-t cut of a graph with the smallest possible source side.

    Every node has, besides its edges, a link to the source and a link to the sink. The source side consists of the
    nodes that the source reaches in the residual graph of a maximum flow. The source side of every other minimum cut
    contains it. The algorithm is preflow-push (A. Goldberg, R. Tarjan, J. ACM 1988) with highest-label selection, gap
    heuristic and global relabelling (B. Cherkassky, A. Goldberg, Algorithmica 1997). Nodes far above their last exact
    label wait for the next global relabelling, and leaves are pruned in advance; so long thin graphs do not take
    quadratic time.

    Capacities are first rounded to integers, so that sums are exact and the result is deterministic. With M the
    largest capacity of an edge, E < 2^b and M < 2^e, the unit is 2^(b+e-60): for a million edges, less than 2e-12 M.
    Zero stays zero, and a positive capacity stays positive. Integers up to 2^60 / 2^b are exact. At each node only the
    difference of the two terminal capacities is rounded.

    Args:
        edge_index: ``[2, E]`` int64, undirected edges, E < 2^30. Self loops are ignored, parallel edges add up.
        capacity: ``[E]`` float32 or float64, the cost of cutting each edge: finite, >= 0.
        source_capacity: ``[N]`` float32 or float64, the cost of putting each node on the sink side; ``inf`` makes
            the node a seed of the source side.
        sink_capacity: ``[N]`` float32 or float64, the cost of putting each node on the source side; ``inf`` makes
            the node a seed of the sink side.

    Returns:
        ``source_side`` ``[N]`` bool, and ``flow``, a float64 scalar: the cost of this cut in the given capacities,
        which equals the maximum flow. No gradient flows through them.

    Raises:
        TypeError: an argument of the wrong type or dtype.
        ValueError: a wrong shape or device, a node number outside [0, N), a NaN or negative capacity, an infinite
            edge, a node with both terminal capacities infinite.

    Example:
        >>> import torch
        >>> edge_index = torch.tensor([[0, 1, 2], [1, 2, 3]])
        >>> source = torch.tensor([torch.inf, 0.0, 0.0, 0.0])
        >>> sink = torch.tensor([0.0, 0.0, 0.0, torch.inf])
        >>> min_cut(edge_index, torch.tensor([3.0, 1.0, 2.0]), source, sink)
        (tensor([ True,  True, False, False]), tensor(1., dtype=torch.float64))
    """
    check_edge_index(edge_index)
    check_array("capacity", capacity, FLOATING, (edge_index.shape[1],), "[E]")
    check_array("source_capacity", source_capacity, FLOATING, (None,), "[N]")
    check_array("sink_capacity", sink_capacity, FLOATING, source_capacity.shape, "[N]")
    return call("min_cut", edge_index, capacity, source_capacity, sink_capacity)


register_fakes(
    connected_components=lambda edge_index, num_nodes: edge_index.new_empty(num_nodes),
    felzenszwalb=lambda edge_index, _weight, num_nodes, *_: edge_index.new_empty(num_nodes),
    merge_regions=lambda _edge_index, _cost, size, *_: torch.empty_like(size),
    region_dendrogram=lambda edge_index, *_: of_one_size(edge_index, (torch.int64, 2), (torch.float64,)),
    min_cut=lambda _edge_index, _capacity, source_capacity, _sink_capacity: (
        source_capacity.new_empty(source_capacity.shape, dtype=torch.bool),
        source_capacity.new_empty((), dtype=torch.float64),
    ),
)
