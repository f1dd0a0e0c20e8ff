"""Time of the metrics on a million points: `python benchmarks/metrics.py` (half a minute).

Points of a square in random order; regions are the Voronoi cells of random seeds; a tenth of the true regions is void.
Medians of five calls, on one thread, in processor time.
"""

import statistics
import time
from collections.abc import Callable

import report
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from torchjoint import metrics, ops
from torchjoint.cloud.neighbors import nearest_neighbors

NUM_POINTS, NUM_TRUE, NEIGHBORS, ROUNDS = 1_000_000, 300, 16, 5
NUM_PREDICTED = (3_000, 30_000)
NAMES = (
    "segmentation_covering",
    "objects_and_parts",
    "average_precision_objects",
    "average_precision_parts",
    "mean_best_iou",
    "scannet_average_precision",
    "achievable_segmentation_accuracy",
    "undersegmentation_error",
)


def regions(points: Tensor, count: int, generator: torch.Generator) -> Tensor:
    seeds = torch.rand(count, 2, generator=generator)
    return torch.from_numpy(cKDTree(seeds.numpy()).query(points[:, :2].numpy())[1]).long()


def milliseconds(function: Callable[[], object]) -> float:
    seconds = []
    for _ in range(ROUNDS):
        start = time.process_time()
        function()
        seconds.append(time.process_time() - start)
    return statistics.median(seconds) * 1000


def main() -> None:
    generator = torch.Generator().manual_seed(0)
    points = torch.rand(NUM_POINTS, 3, generator=generator) * torch.tensor([1, 1, 0])
    edges = ops.neighbor_edges(nearest_neighbors(points, NEIGHBORS).indices)
    target = regions(points, NUM_TRUE, generator)
    target[target % 10 == 0] = -1
    preds = [regions(points, count, generator) for count in NUM_PREDICTED]
    torch.set_num_threads(1)

    rows = []
    for name in NAMES:
        function = getattr(metrics, name)
        rows.append([f"`{name}`", *(milliseconds(lambda f=function, p=pred: f(p, target)) for pred in preds)])
    recall = [milliseconds(lambda p=pred: metrics.boundary_recall(p, target, edges)) for pred in preds]
    rows.append([f"`boundary_recall`, {edges.shape[1] / 1e6:.1f} M edges", *recall])
    columns = {"measure": 0} | {f"{count:,} regions, ms": 0 for count in NUM_PREDICTED}
    report.save("metrics", [report.Table(columns, rows)])


if __name__ == "__main__":
    main()
