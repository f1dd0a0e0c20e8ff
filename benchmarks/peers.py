"""Implementations of the same operators in other libraries, if these are installed."""

from collections.abc import Callable
from importlib.util import find_spec

import cv2
import numpy as np
import skimage.segmentation
import torch
from instances import Cut
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import maximum_flow
from torch import Tensor


def image_segmenters(image: Tensor, scale: float, min_size: int) -> dict[str, Callable[[], object]]:
    """Felzenszwalb-Huttenlocher on an image [3, H, W]: colour distances only, no smoothing."""
    pixels = np.ascontiguousarray(image.permute(1, 2, 0).numpy())
    pixels_255 = pixels * 255
    graph_segmentation = cv2.ximgproc.segmentation.createGraphSegmentation(0.001, scale * 255, min_size)
    return {
        "scikit-image": lambda: skimage.segmentation.felzenszwalb(
            pixels, scale=scale * 255, sigma=0, min_size=min_size, channel_axis=-1
        ),
        "OpenCV (4-connected)": lambda: graph_segmentation.processImage(pixels_255),
    }


def cutters(cut: Cut) -> dict[str, Callable[[], object]]:
    """Minimum cuts from the same tensors; each function builds the graph, solves it, and returns labels."""
    found = {"SciPy": _scipy_cut(cut)}
    if find_spec("maxflow") is not None:
        found |= {f"PyMaxflow {name}": run for name, run in _pymaxflow_cuts(cut).items()}
    if find_spec("ortools") is not None:
        found["OR-tools"] = _ortools_cut(cut)
    return found


def best_of_each(times: dict[str, float]) -> dict[str, float]:
    """Keeps only the fastest of PyMaxflow's variants."""
    ways = [taken for name, taken in times.items() if name.startswith("PyMaxflow")]
    rest = {name: taken for name, taken in times.items() if not name.startswith("PyMaxflow")}
    return rest | ({"PyMaxflow, its fastest way": min(ways)} if ways else {})


def _finite(cut: Cut) -> tuple[np.ndarray, np.ndarray]:
    """Terminal capacities; infinity is replaced by more than the sum of all edges."""
    enough = float(cut.capacity.sum()) + 1
    return tuple(terminal.clamp(max=enough).numpy() for terminal in (cut.source, cut.sink))


def _pymaxflow_cuts(cut: Cut) -> dict[str, Callable[[], np.ndarray]]:
    """PyMaxflow's variants: integers (of 30 bits) or floats; edges as lists or, for a grid, as layers."""
    import maxflow

    unit = 2**30 / float(cut.capacity.max())
    found = {}
    for kind, graph_type, convert in (
        ("float", maxflow.GraphFloat, lambda values: values),
        ("int", maxflow.GraphInt, lambda values: (values * unit).round().astype(np.int64)),
    ):
        terminals = [convert(values) for values in _finite(cut)]
        found[f"{kind} edges"] = _by_edges(graph_type, cut, convert(cut.capacity.numpy()), terminals)
        if cut.grid is not None:
            layers = [(convert(weights), structure) for weights, structure in _grid_layers(cut)]
            found[f"{kind} layers"] = _by_layers(graph_type, cut.grid, layers, terminals)
    return found


def _by_edges(
    graph_type: type, cut: Cut, capacity: np.ndarray, terminals: list[np.ndarray]
) -> Callable[[], np.ndarray]:
    first, second = np.ascontiguousarray(cut.edge_index.numpy())

    def run() -> np.ndarray:
        graph = graph_type(len(terminals[0]), len(capacity))
        nodes = graph.add_grid_nodes((len(terminals[0]),))
        graph.add_edges(first, second, capacity, capacity)
        graph.add_grid_tedges(nodes, *terminals)
        graph.maxflow()
        return graph.get_grid_segments(nodes)

    return run


def _by_layers(
    graph_type: type, size: tuple[int, int], layers: list[tuple[np.ndarray, np.ndarray]], terminals: list[np.ndarray]
) -> Callable[[], np.ndarray]:
    terminals = [values.reshape(size) for values in terminals]

    def run() -> np.ndarray:
        graph = graph_type(terminals[0].size, 4 * terminals[0].size)
        nodes = graph.add_grid_nodes(size)
        for weights, structure in layers:
            graph.add_grid_edges(nodes, weights, structure, symmetric=True)
        graph.add_grid_tedges(nodes, *terminals)
        graph.maxflow()
        return graph.get_grid_segments(nodes)

    return run


def _grid_layers(cut: Cut) -> list[tuple[np.ndarray, np.ndarray]]:
    """Edge weights of a grid in PyMaxflow's format: per direction an array [H, W] and a 3 x 3 structure."""
    height, width = cut.grid
    first, second = cut.edge_index.numpy()
    layers = []
    for down, right in ((0, 1), (1, 0), (1, 1), (-1, 1)):
        of_direction = (second // width - first // width == down) & (second % width - first % width == right)
        weights = np.zeros((height, width))
        weights.flat[first[of_direction]] = cut.capacity.numpy()[of_direction]
        structure = np.zeros((3, 3))
        structure[1 + down, 1 + right] = 1
        layers.append((weights, structure))
    return layers


def _scipy_cut(cut: Cut) -> Callable[[], object]:
    """SciPy's minimum cut, with capacities rounded to 20 bits: SciPy supports only 32-bit integers."""
    unit = 2**20 / float(cut.capacity.max())
    count = len(cut.source)
    first, second = cut.edge_index.numpy()
    capacity = (cut.capacity.numpy() * unit).round().astype(np.int32)
    ends = [(terminal * unit).clamp(max=2**28).round().int().numpy() for terminal in (cut.source, cut.sink)]
    nodes = np.arange(count)
    rows = np.concatenate([first, second, np.full(count, count), nodes])
    columns = np.concatenate([second, first, nodes, np.full(count, count + 1)])
    values = np.concatenate([capacity, capacity, *ends])

    def run() -> object:
        graph = coo_matrix((values, (rows, columns)), shape=(count + 2, count + 2)).tocsr()
        return maximum_flow(graph, count, count + 1)

    return run


def _ortools_cut(cut: Cut) -> Callable[[], object]:
    from ortools.graph.python import max_flow

    unit = 2**30 / float(cut.capacity.max())
    source, sink = _finite(cut)
    count = len(source)
    nodes = np.arange(count)
    first, second = cut.edge_index.numpy()
    capacity = (cut.capacity.numpy() * unit).astype(np.int64)

    def run() -> object:
        solver = max_flow.SimpleMaxFlow()
        solver.add_arcs_with_capacity(first, second, capacity)
        solver.add_arcs_with_capacity(second, first, capacity)
        solver.add_arcs_with_capacity(np.full(count, count), nodes, (source * unit).astype(np.int64))
        solver.add_arcs_with_capacity(nodes, np.full(count, count + 1), (sink * unit).astype(np.int64))
        solver.solve(count, count + 1)
        return solver.get_source_side_min_cut()

    return run


def check_cuts_agree(cut: Cut, ours: Tensor) -> None:
    """Raises AssertionError if PyMaxflow is installed and finds a cut of another value."""
    if find_spec("maxflow") is None:
        return
    source, sink = (torch.from_numpy(terminal) for terminal in _finite(cut))

    def value(source_side: Tensor) -> float:
        first, second = source_side[cut.edge_index]
        return float(cut.capacity[first != second].sum() + sink[source_side].sum() + source[~source_side].sum())

    for name, run in _pymaxflow_cuts(cut).items():
        theirs = value(~torch.from_numpy(np.asarray(run())).flatten())
        if abs(theirs - value(ours)) > 1e-6 * value(ours):
            raise AssertionError(f"PyMaxflow's cut ({name}) costs {theirs}, ours {value(ours)}")
