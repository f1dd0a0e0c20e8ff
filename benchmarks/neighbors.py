"""Times nearest neighbours against SciPy, Open3D and pgeof: `python benchmarks/neighbors.py [--points N ...]`.

Each finds the same neighbours of all points. Processor time is given, the least of calls in turn, because other work on
the machine changes it less than wall time; on one thread, because threads that wait take some, too. Open3D and pgeof
are included if they are installed. Clouds of a million points and more are searched once.
"""

import argparse
import os
import time
from collections.abc import Callable
from importlib.util import find_spec

os.environ["OMP_NUM_THREADS"] = "1"

import report
import torch
from instances import room
from scipy.spatial import cKDTree
from torch import Tensor

import torchjoint as tj

#: From this number of points on, one call each.
LARGE = 1_000_000

Search = Callable[[Tensor, int], object]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--points", type=int, nargs="+", default=[10_000, 100_000])
    parser.add_argument("--count", type=int, nargs="+", default=[4, 24, 30, 45])
    parser.add_argument("--calls", type=int, default=3)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    searches = contenders()
    rows = []
    for num_points in arguments.points:
        for kind, points in clouds(num_points).items():
            for count in arguments.count:
                calls = arguments.calls if num_points < LARGE else 1
                times = least(searches, points, count, calls)
                ours, *others = times.values()
                name = f"{kind}, {len(points):,}, {count}"
                rows.append([name, *(1e6 * taken / len(points) for taken in times.values()), min(others) / ours])
                print(rows[-1], flush=True)
    columns = {"points, neighbours": 0} | {f"{name}, µs a point": 2 for name in searches} | {"best other / ours": 2}
    name = "neighbors_large" if min(arguments.points) >= LARGE else "neighbors"
    report.save(name, [report.Table(columns, rows)])


def clouds(num_points: int) -> dict[str, Tensor]:
    """A room; a scan, whose density falls with the square of the distance; and random points in a cube."""
    generator = torch.Generator().manual_seed(0)
    sphere = torch.nn.functional.normalize(torch.randn(num_points, 3, generator=generator), dim=1)
    scan = sphere * (2 / sphere.abs().amax(1, keepdim=True)) * torch.tensor([5.0, 3.0, 1.0])  # a long hall, seen inside
    return {"room": room(num_points), "scan": scan, "uniform": torch.rand(num_points, 3, generator=generator)}


def contenders() -> dict[str, Search]:
    searches: dict[str, Search] = {"ours": ours, "SciPy": scipy}
    if find_spec("open3d"):
        searches["Open3D"] = open3d
    if find_spec("pgeof"):
        searches["pgeof"] = pgeof
    return searches


def ours(points: Tensor, count: int) -> object:
    return tj.ops.nearest_neighbors(points, count)


def scipy(points: Tensor, count: int) -> object:
    coordinates = points.double().numpy()
    tree = cKDTree(coordinates, leafsize=24, balanced_tree=False, compact_nodes=False)
    return tree.query(coordinates[tree.indices], k=count + 1, workers=1)  # in the tree's order, which is quicker


def open3d(points: Tensor, count: int) -> object:
    import open3d as o3d

    cloud = o3d.core.Tensor(points.numpy())
    search = o3d.core.nns.NearestNeighborSearch(cloud)
    search.knn_index()
    return search.knn_search(cloud, count + 1)


def pgeof(points: Tensor, count: int) -> object:
    import pgeof

    return pgeof.knn_search(points.numpy(), points.numpy(), count + 1)


def least(searches: dict[str, Search], points: Tensor, count: int, calls: int) -> dict[str, float]:
    """Seconds of processor time of each."""
    times: dict[str, float] = {}
    for _ in range(calls):
        for name, search in searches.items():
            before = time.process_time()
            search(points, count)
            times[name] = min(times.get(name, float("inf")), time.process_time() - before)
    return times


if __name__ == "__main__":
    main()
