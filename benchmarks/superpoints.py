"""Times superpoints in one call and the same work by hand: `python benchmarks/superpoints.py [--large POINTS]`.

"By hand" combines the best public parts: Open3D's neighbours, normals from Open3D or from torch's eigenvectors, unique
edges by packed keys, weights in torch, and a graph segmentation, for which our own operator is used.
"""

import argparse
import subprocess
import sys
from collections.abc import Callable

import numpy as np
import open3d as o3d
import report
import torch
from instances import room
from interleaved import medians
from torch import Tensor

import torchjoint as tj

NEIGHBORS, SCALE, MIN_SIZE = 16, 1.0, 20
LARGE = """
import re, sys, time, torch, torchjoint as tj
sys.path.insert(0, {folder!r})
from instances import room
points = room({count})
if {sort}:
    points = points[torch.argsort((points[:, 0] * 10).floor() * 1e6 + points[:, 1])]
start = time.perf_counter()
labels = tj.superpoints(points)
seconds = time.perf_counter() - start
peak = int(re.search(r"VmHWM:\\s*(\\d+) kB", open("/proc/self/status").read())[1])
print(seconds, peak / 2**20, int(labels.max()) + 1)
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--points", type=int, default=150_000)
    parser.add_argument("--large", type=int, default=10_000_000, help="points of the cloud whose memory is measured")
    arguments = parser.parse_args()
    points = room(arguments.points)
    times = medians(
        {
            "`tj.superpoints`": lambda: superpoints(points),
            "by hand, Open3D's normals": lambda: by_hand(points, open3d_normals),
            "by hand, torch's eigenvectors": lambda: by_hand(points, torch_normals),
        },
        seconds=12,
    )
    ours = times["`tj.superpoints`"]
    rows = [[name, taken, ours / taken] for name, taken in times.items()]
    title = f"{arguments.points:,} points, {NEIGHBORS} neighbours"
    small = report.Table({"way": 0, "ms": 0, "ours / this": 2}, rows, title)
    rows = [[name, *large(arguments.large, sort)] for name, sort in (("in no order", False), ("along x and y", True))]
    title = f"{arguments.large:,} points, the preset without colours, the whole process"
    whole = report.Table({"points": 0, "s": 0, "peak GB": 1, "superpoints": 0}, rows, title)
    report.save("superpoints", [small, whole])


def superpoints(points: Tensor) -> Tensor:
    return tj.superpoints(points, neighbors=NEIGHBORS, normal_neighbors=NEIGHBORS, scale=SCALE, min_size=MIN_SIZE)


def by_hand(points: Tensor, normals_of: Callable[[Tensor, Tensor], Tensor]) -> Tensor:
    count = len(points)
    cloud = o3d.core.Tensor(points.numpy())
    search = o3d.core.nns.NearestNeighborSearch(cloud)
    search.knn_index()
    neighbors = torch.from_numpy(search.knn_search(cloud, NEIGHBORS + 1)[0].numpy())[:, 1:]
    normals = normals_of(points, neighbors)
    first = torch.arange(count)[:, None].expand(-1, NEIGHBORS).flatten()
    second = neighbors.flatten()
    key = torch.unique(torch.minimum(first, second) * count + torch.maximum(first, second))
    edges = torch.stack([key // count, key % count])
    a, b = normals[edges[0]], normals[edges[1]]
    weight = torch.atan2(torch.linalg.cross(a, b).norm(dim=1), (a * b).sum(dim=1).abs())
    return tj.ops.felzenszwalb(edges, weight, count, SCALE, MIN_SIZE)


def open3d_normals(points: Tensor, neighbors: Tensor) -> Tensor:
    cloud = o3d.t.geometry.PointCloud(o3d.core.Tensor(points.numpy()))
    cloud.estimate_normals(max_nn=NEIGHBORS + 1)
    return torch.from_numpy(np.array(cloud.point.normals.numpy()))


def torch_normals(points: Tensor, neighbors: Tensor) -> Tensor:
    points = points.double()
    around = torch.cat([points[:, None], points[neighbors]], dim=1)
    around = around - around.mean(dim=1, keepdim=True)
    return torch.linalg.eigh(around.transpose(1, 2) @ around).eigenvectors[:, :, 0].float()


def large(count: int, sort: bool) -> tuple[float, float, int]:
    code = LARGE.format(folder=str(report.HERE), count=count, sort=sort)
    output = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout
    seconds, peak, number = output.split()
    return float(seconds), float(peak), int(number)


if __name__ == "__main__":
    main()
