"""Times the graph operators and the other installed libraries: `python benchmarks/ops.py [--largest EDGES]`.

Times are medians of calls in turn, on one thread. peers.py has the other libraries, instances.py the inputs. PyMaxflow
(GPL) and OR-tools are included if they are installed; nothing here requires them.
"""

import argparse
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import peers
import report
import torch
from floor import argsort_floor
from instances import (
    Cut,
    Graph,
    bottleneck,
    chain,
    equal_capacities,
    image_cut,
    image_graph,
    photograph,
    room,
    sparse,
    square_of,
)
from interleaved import medians

import torchjoint as tj
from torchjoint.cloud.edge_weights import geometric_weights
from torchjoint.cloud.graph import undirected_edges
from torchjoint.cloud.neighbors import nearest_neighbors
from torchjoint.cloud.normals import estimate_normals
from torchjoint.config import ImageGraphConfig, ImageSegmentsConfig, PointGraphConfig
from torchjoint.images.pixel_graph import segment_image

SCALE, MIN_SIZE = 1.0, 100
SIZES = {"640x480": (480, 640), "1296x968": (968, 1296)}
CUTS: dict[str, Callable[[], list[Cut]]] = {
    f"six image parts {size}x{size}, {'soft' if soft else 'seeds'}": lambda size=size, soft=soft: [
        image_cut(size, soft=soft, number=number) for number in range(6)
    ]
    for soft in (False, True)
    for size in (50, 100, 200)
} | {
    "all capacities equal, 100x100": lambda: [equal_capacities(100)],
    "chain of 30,000, every 10th with terminals": lambda: [chain(30_000, 10)],
    "chain of 30,000, every 1000th with terminals": lambda: [chain(30_000, 1000)],
    "two grids 70x70, one bridge": lambda: [bottleneck(70)],
    "random, 10,000 nodes, degree 6": lambda: [sparse(10_000)],
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--largest", type=float, default=1e7, help="edges of the largest graph in the plot")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    measures = {"felzenszwalb": edge_lists, "images": images, "min_cut": cuts, "two_threads": threads}
    for name, measure in measures.items():
        report.save(name, [measure()])
    growth(np.geomspace(1e4, arguments.largest, 7))


def edge_lists() -> report.Table:
    """Table: felzenszwalb and its lower bound (floor.py)."""
    rows = []
    graphs = {f"8-connected {name}": image_graph(photograph(*size)) for name, size in SIZES.items()}
    graphs["kNN-16 of 150,000 points"] = point_graph(150_000)
    for name, graph in graphs.items():
        times = medians(
            {
                "floor": argsort_floor(graph.weight),
                "ours": lambda g=graph: tj.ops.felzenszwalb(*g, SCALE, MIN_SIZE),
            }
        )
        rows.append([name, len(graph.weight), times["floor"], times["ours"], times["ours"] / times["floor"]])
    return report.Table({"graph": 0, "edges": 0, "floor, ms": 1, "felzenszwalb, ms": 1, "ratio": 2}, rows)


def point_graph(num_points: int) -> Graph:
    points = room(num_points)
    neighbors = nearest_neighbors(points, 16).indices
    edges = undirected_edges(neighbors)
    normals = estimate_normals(points, neighbors)
    signs_known = torch.zeros(num_points, dtype=torch.bool)
    return Graph(edges, geometric_weights(points, edges, normals, signs_known, PointGraphConfig()), num_points)


def images() -> report.Table:
    """Table: image segmentation, from pixels to labels."""
    rows, columns = [], {}
    for name, size in SIZES.items():
        image = photograph(*size)
        times = medians(
            {
                "felzenszwalb": lambda i=image: segment(i),
                **peers.image_segmenters(image, SCALE, MIN_SIZE),
            }
        )
        columns = against("felzenszwalb", times)
        rows.append([name, *columns.values()])
    return report.Table({"image": 0} | dict.fromkeys(columns, 1), rows)


def against(ours: str, times: dict[str, float], calls: int = 1) -> dict[str, float]:
    """Cells of a row by column: milliseconds of each of the calls, and the others' ratios to ours."""
    found = {f"{name}, ms": taken / calls for name, taken in times.items()}
    return found | {f"{name} / ours": taken / times[ours] for name, taken in times.items() if name != ours}


def segment(image: torch.Tensor) -> torch.Tensor:
    settings = ImageGraphConfig(smoothing=0), ImageSegmentsConfig(scale=SCALE, min_size=MIN_SIZE)
    return segment_image(image, torch.zeros(image.shape[1:]), *settings)


def cuts() -> report.Table:
    """Table: minimum cuts, from tensors to labels."""
    rows, columns = [], {}
    for name, make in CUTS.items():
        instances = make()
        contenders: dict[str, list[Callable[[], object]]] = {}
        for cut in instances:
            peers.check_cuts_agree(cut, tj.ops.min_cut(*cut[:4])[0])
            for peer, run in {"min_cut": lambda c=cut: tj.ops.min_cut(*c[:4]), **peers.cutters(cut)}.items():
                contenders.setdefault(peer, []).append(run)
        times = peers.best_of_each(
            medians({peer: lambda runs=runs: [run() for run in runs] for peer, runs in contenders.items()})
        )
        columns = against("min_cut", times, len(instances))
        rows.append([name, *columns.values()])
    return report.Table({"graph": 0} | dict.fromkeys(columns, 2), rows)


def threads() -> report.Table:
    """Table: two simultaneous calls in two Python threads, and a single call."""
    graph, image, cut = image_graph(photograph(480, 640)), photograph(480, 640), image_cut(200)
    functions = {
        "felzenszwalb, 640x480": lambda: tj.ops.felzenszwalb(*graph, SCALE, MIN_SIZE),
        "from an image to labels, 640x480": lambda: segment(image),
        "min_cut, 200x200": lambda: tj.ops.min_cut(*cut[:4]),
    }
    rows = []
    with ThreadPoolExecutor(2) as pool:
        for name, function in functions.items():
            times = medians({"one": function, "two": lambda f=function: list(pool.map(lambda _: f(), range(2)))})
            rows.append([name, times["one"], times["two"], 2 * times["one"] / times["two"]])
    return report.Table({"operator": 0, "one call, ms": 1, "two at once, ms": 1, "speed-up": 2}, rows)


def growth(edges: np.ndarray) -> None:
    """Plots time over size."""
    curves: dict[str, dict[float, float]] = {}
    for count in edges:
        side = square_of(count)
        image = photograph(side, side)
        graph = image_graph(image)
        functions = {
            "felzenszwalb, edges given": lambda g=graph: tj.ops.felzenszwalb(*g, SCALE, MIN_SIZE),
            "felzenszwalb, from an image": lambda i=image: segment(i),
            "floor: radix argsort of the weights": argsort_floor(graph.weight),
            **peers.image_segmenters(image, SCALE, MIN_SIZE),
        }
        for name, taken in medians(functions, seconds=2, least=2).items():
            curves.setdefault(name, {})[len(graph.weight)] = taken
        print(f"{len(graph.weight):,} edges", flush=True)
    cut_curves: dict[str, dict[float, float]] = {}
    for size in (30, 50, 80, 120, 200, 300):
        cut = image_cut(size)
        functions = {"min_cut": lambda c=cut: tj.ops.min_cut(*c[:4]), **peers.cutters(cut)}
        for name, taken in peers.best_of_each(medians(functions, seconds=1, least=2)).items():
            cut_curves.setdefault(name, {})[len(cut.capacity)] = taken
    figure, axes = plt.subplots(1, 2, figsize=(11, 4), layout="constrained")
    for axis, title, part in zip(axes, ("graph segmentation", "minimum cut"), (curves, cut_curves), strict=True):
        for name, points in part.items():
            axis.loglog(list(points), list(points.values()), "o-", label=name, markersize=3)
        axis.set(title=title, xlabel="edges", ylabel="ms, one thread")
        axis.grid(alpha=0.3)
        axis.legend(fontsize=8)
    figure.savefig(Path(__file__).with_name("growth.png"), dpi=80)


if __name__ == "__main__":
    main()
