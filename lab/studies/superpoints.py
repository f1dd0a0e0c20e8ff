"""How good are superpoints, beside those that one can install? At equal numbers of superpoints, on scenes with truth.

    python lab/studies/superpoints.py WORK --data DATA [--cut-pursuit PYTHON] [--scenes 4] [--write]

The scenes are real ones of `torchjoint-lab real` and generated rooms, at most --scenes of each kind. Each method has
one parameter of size. It runs with some values of it, and its scores are interpolated at the same numbers of
superpoints. What is no thing is one region more of the truth; void points do not count. Borders are edges between ten
nearest neighbours, and a border one edge away is found. PYTHON is the interpreter of an environment with `pip install
pycut-pursuit pgeof "numpy<2"`. It is run as a program, because pycut-pursuit is GPL; without it cut pursuit has no
row. WORK keeps what is done.
"""

from __future__ import annotations

import argparse
import functools
import json
import math
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import open3d as o3d
import report
import torch
from scipy.spatial import cKDTree
from torch import Tensor
from torch.nn.functional import normalize
from torchjoint_lab.benchmark.real_scenes import all_known, find_real_scenes
from torchjoint_lab.benchmark.robustness_scenes import find_scenes

import torchjoint as tj
from torchjoint.runtime.files import write_text

REAL = ("shelf", "tote", "rio", "ycb", "mosd")
#: Mean numbers of points of a superpoint at which methods are compared.
POINTS = (400, 200, 100)
#: The ratio of two values of a parameter, and the most steps to fewer, and to more superpoints.
STEP, MOST = 2.5, 10
#: Neighbours in graphs, and points of the smallest superpoint where this is not the method's own.
NEIGHBORS, LEAST = 10, 20
#: Weights of colours, places and normals, and rounds, of the clusters; the weights are those of VCCS in PCL's example.
CLUSTER_WEIGHTS, ROUNDS = (0.2, 0.4, 1.0), 10
JOINED = "the same with `scale=0.1` and `joining`"
CUT = "cut pursuit, pgeof's features"
#: The page with a short table, and its rows.
PAGE = Path(__file__).parents[2] / "docs" / "superpoints.md"
ON_PAGE = ("`tj.superpoints`", JOINED, "clusters as of VCCS and SLIC", CUT)
#: What the interpreter with cut pursuit runs, as Superpoint Transformer does on ScanNet, but without its heights above
#: the floor: FILE.npz (points, colors), the strength of regularization, the file of labels. Writes its seconds.
CUT_PURSUIT = """
import sys, time
import numpy as np, pgeof
from pycut_pursuit.cp_d0_dist import cp_d0_dist
given = np.load(sys.argv[1])
points, colors = given["points"], given["colors"]
start = time.process_time()
count, some, many = len(points), 10, 45
near, square = pgeof.knn_search(points, points, many + 1)
table = np.ascontiguousarray(near[:, 1:]).reshape(-1)
shape = pgeof.compute_features(points, table, (many * np.arange(count + 1)).astype("u4"), 1)[:, :4]
values = np.concatenate([points - points.mean(0), colors, shape], 1).astype("f4")
away = np.sqrt(square[:, 1 : some + 1]).reshape(-1)
weights = (float(sys.argv[2]) / (1 + away / away.mean())).astype("f4")
coordinates = np.ones(values.shape[1], "f4")
coordinates[:3] = 0.1
labels, _ = cp_d0_dist(
    values.shape[1], np.asfortranarray(values.T), (some * np.arange(count + 1)).astype("u4"),
    np.ascontiguousarray(near[:, 1 : some + 1]).reshape(-1), edge_weights=weights, vert_weights=np.ones(count, "f4"),
    coor_weights=coordinates, min_comp_weight=10, cp_dif_tol=1e-2, cp_it_max=15, split_damp_ratio=0.7,
    max_num_threads=1, verbose=False,
)
print("seconds", time.process_time() - start)
np.save(sys.argv[3], labels.astype("i8"))
"""


class Sample(NamedTuple):
    """A cloud with truth."""

    kind: str
    points: Tensor  #: [N, 3]
    colors: Tensor | None  #: [N, 3]
    truth: Tensor  #: [N] int64, -1 = void
    edges: Tensor  #: [2, E]


class Run(NamedTuple):
    """What a method gave with one value of its parameter."""

    size: float
    number: int
    recall: float  #: of borders
    error: float  #: under-segmentation
    accuracy: float  #: achievable
    seconds: float  #: of the processor


class Method(NamedTuple):
    """Labels [N] and seconds of a cloud by its parameter of size, of which more gives fewer; and where to begin."""

    run: Callable[[Sample, float], tuple[Tensor, float]]
    first: float


def timed(labels: Callable[[Sample, float], Tensor]) -> Callable[[Sample, float], tuple[Tensor, float]]:
    """The function with its seconds."""

    def run(sample: Sample, size: float) -> tuple[Tensor, float]:
        start = time.process_time()
        return labels(sample, size), time.process_time() - start

    return run


def default(sample: Sample, size: float) -> Tensor:
    return tj.superpoints(sample.points, sample.colors, scale=size)


def without_colors(sample: Sample, size: float) -> Tensor:
    return tj.superpoints(sample.points, scale=size)


def joined(sample: Sample, size: float) -> Tensor:
    return tj.superpoints(sample.points, sample.colors, scale=0.1, joining=size)


def segmentator(sample: Sample, size: float) -> Tensor:
    return tj.superpoints(sample.points, preset="segmentator", scale=size)


def by_hand(sample: Sample, size: float) -> Tensor:
    """Open3D's neighbours and normals, the angle as weight, and our operator for the segmentation."""
    cloud = o3d.t.geometry.PointCloud(o3d.core.Tensor(sample.points.float().numpy()))
    cloud.estimate_normals(max_nn=30)
    normals = torch.from_numpy(cloud.point.normals.numpy().copy())
    search = o3d.core.nns.NearestNeighborSearch(cloud.point.positions)
    search.knn_index()
    table = torch.from_numpy(search.knn_search(cloud.point.positions, NEIGHBORS + 1)[0].numpy())
    edges = tj.ops.neighbor_edges(table)
    a, b = normals[edges[0]], normals[edges[1]]
    turn = torch.atan2(torch.linalg.cross(a, b).norm(dim=1), (a * b).sum(1).abs())
    return tj.ops.felzenszwalb(edges, turn, len(sample.points), size, LEAST)


def clusters(sample: Sample, size: float) -> Tensor:
    """Clusters of places, colours and normals as VCCS and SLIC have them: about one for each `size` points.

    The first centres are the points nearest to those of cells of a grid; a point goes to one of the eight nearest. At
    last a cluster that is not connected becomes several, and what is too small joins the nearest.
    """
    of_color, of_place, of_normal = CLUSTER_WEIGHTS
    points = sample.points.double()
    normals = tj.ops.fit_normals(sample.points, tj.ops.nearest_neighbors(sample.points, 30)[0]).double()
    colors = torch.zeros_like(points) if sample.colors is None else sample.colors.double()
    side = cell_of(points, len(points) / size)
    cells = torch.unique((points / side).floor(), dim=0)
    seeds = np.unique(cKDTree(points.numpy()).query((cells.numpy() + 0.5) * float(side))[1])
    place, color, normal = points[seeds], colors[seeds], normals[seeds]
    for _ in range(ROUNDS):
        near = torch.from_numpy(cKDTree(place.numpy()).query(points.numpy(), min(8, len(place)))[1])
        near = near.view(len(points), -1)
        distance = of_place * (points[:, None] - place[near]).square().sum(2) / (3 * side**2)
        distance += of_color * (colors[:, None] - color[near]).square().sum(2)
        distance += of_normal * (1 - (normals[:, None] * normal[near]).sum(2).abs()).square()
        labels = near.gather(1, distance.argmin(1, keepdim=True))[:, 0]
        kept, labels = labels.unique(return_inverse=True)
        signed = normals * torch.where((normals * normal[kept][labels]).sum(1, keepdim=True) < 0, -1, 1)
        number = labels.bincount()[:, None]
        place, color, normal = (
            torch.zeros(len(kept), 3, dtype=torch.float64).index_add_(0, labels, of) / number
            for of in (points, colors, signed)
        )
        normal = normalize(normal, dim=1)
    edges = tj.ops.neighbor_edges(tj.ops.nearest_neighbors(sample.points, NEIGHBORS)[0])
    a, b = edges
    apart = torch.where(labels[a] == labels[b], 0, (points[a] - points[b]).norm(dim=1) + 1e-9)
    return tj.ops.felzenszwalb(edges, apart, len(points), 0.0, max(LEAST, int(size / 4)))


def cell_of(points: Tensor, count: float) -> float:
    """The side of a grid's cells of which about `count` have points."""
    low, high = 1e-4, float((points.amax(0) - points.amin(0)).max())
    for _ in range(20):
        middle = math.sqrt(low * high)
        more = len(torch.unique((points / middle).floor(), dim=0)) > count
        low, high = (middle, high) if more else (low, middle)
    return high


def cut_pursuit(python: Path, sample: Sample, size: float) -> tuple[Tensor, float]:
    """Cut pursuit on geometric features, places and colours, by a program."""
    points = sample.points.double() - sample.points.double().mean(0)
    colors = torch.zeros(len(points), 0) if sample.colors is None else sample.colors
    with tempfile.TemporaryDirectory() as folder:
        given, labels = Path(folder) / "cloud.npz", Path(folder) / "labels.npy"
        np.savez(given, points=points.float().numpy(), colors=colors.float().numpy())
        words = [str(python), "-c", CUT_PURSUIT, str(given), str(size), str(labels)]
        told = subprocess.run(words, check=True, capture_output=True, text=True).stdout
        seconds = next(float(line.split()[1]) for line in told.splitlines() if line.startswith("seconds"))
        return torch.from_numpy(np.load(labels)), seconds


def methods(python: Path | None) -> dict[str, Method]:
    found = {
        "`tj.superpoints`": Method(timed(default), 1.0),
        JOINED: Method(timed(joined), 5.0),
        "without colours": Method(timed(without_colors), 1.0),
        "preset `segmentator`, on neighbours": Method(timed(segmentator), 0.01),
        "by hand, Open3D's normals": Method(timed(by_hand), 1.0),
        "clusters as of VCCS and SLIC": Method(timed(clusters), float(POINTS[1])),
    }
    if python is not None:
        found[CUT] = Method(functools.partial(cut_pursuit, python), 0.02)
    return found


def load(data: Path | None, count: int) -> dict[str, Callable[[], Sample]]:
    """The scenes by name."""
    found: dict[str, Callable[[], Sample]] = {}
    for kind in REAL if data else ():
        of_kind = [one for one in find_real_scenes(data, (kind,)) if not one.masks]  # type: ignore[arg-type]
        found |= {one.name: functools.partial(sample_of, kind, one.load) for one in of_kind[:count]}
    for room in find_scenes(("room",), count, None):
        found[room.name] = functools.partial(sample_of, "room", lambda room=room: all_known(room.load()))  # type: ignore[misc]
    return found


def sample_of(kind: str, read: Callable[[], tuple[tj.Scene, tuple[Tensor, Tensor]]]) -> Sample:
    """The cloud of a scene; what is no thing is one region more."""
    scene, (instance, other) = read()
    truth = torch.where(other, int(instance.max()) + 1, instance)
    edges = tj.ops.neighbor_edges(tj.ops.nearest_neighbors(scene.points, NEIGHBORS)[0])
    return Sample(kind, scene.points, scene.colors, truth, edges)


def judge(sample: Sample, method: Method, size: float) -> Run:
    labels, seconds = method.run(sample, size)
    of = (labels, sample.truth)
    recall = tj.metrics.boundary_recall(*of, sample.edges)
    error, accuracy = tj.metrics.undersegmentation_error(*of), tj.metrics.achievable_segmentation_accuracy(*of)
    return Run(size, len(labels.unique()), recall, error, accuracy, seconds)


def sweep(sample: Sample, method: Method) -> list[Run]:
    """Runs with values of the parameter on both sides of all numbers of superpoints, if there are such."""
    few, many = len(sample.points) / POINTS[0], len(sample.points) / POINTS[-1]
    method.run(sample, method.first)  # warms up
    runs = [judge(sample, method, method.first)]
    for step, is_past in ((STEP, lambda run: run.number <= few), (1 / STEP, lambda run: run.number >= many)):
        last = runs[0]
        for _ in range(MOST):
            if is_past(last):
                break
            last = judge(sample, method, last.size * step)
            runs.append(last)
    return sorted(runs, key=lambda run: run.number)


def at(runs: list[Run], count: float) -> list[float]:
    """Scores and seconds interpolated, over the logarithm of the number; not a number where no run is so far."""
    known = np.log([run.number for run in runs])
    return [
        float(np.interp(math.log(count), known, values, left=math.nan, right=math.nan))
        for values in zip(*(run[2:] for run in runs), strict=True)
    ]


def measure(
    work: Path, name: str, read: Callable[[], Sample], chosen: dict[str, Method]
) -> dict[str, list[list[float]]]:
    """For each method [numbers of superpoints, (recall, error, accuracy, ms per 100,000 points)] of a scene."""
    file = work / f"{name}.json"
    done = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}
    if missing := [method for method in chosen if method not in done]:
        sample = read()
        done |= {"kind": sample.kind, "points": len(sample.points)}
        for method in missing:
            done[method] = sweep(sample, chosen[method])
            write_text(file, json.dumps(done))
            print(name, method, [run[1] for run in done[method]], flush=True)
    found = {}
    for method in chosen:
        rows = [at([Run(*run) for run in done[method]], done["points"] / each) for each in POINTS]
        found[method] = [[*row[:3], 1e8 * row[3] / done["points"]] for row in rows]
    return {"kind": done["kind"], **found}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("work", type=Path)
    parser.add_argument("--data", type=Path)
    parser.add_argument("--cut-pursuit", type=Path, help="interpreter that has pycut-pursuit and pgeof")
    parser.add_argument("--scenes", type=int, default=4, help="of each kind")
    report.add_write(parser)
    arguments = parser.parse_args()
    arguments.work.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)
    chosen = methods(arguments.cut_pursuit)
    found = [measure(arguments.work, *scene, chosen) for scene in load(arguments.data, arguments.scenes).items()]
    kinds = sorted({scene["kind"] for scene in found})
    ours = np.array([scene[next(iter(chosen))] for scene in found])
    rows: list[list[str]] = []
    for method in chosen:
        values = np.array([scene[method] for scene in found])  # [scenes, numbers, 4]
        of_kinds = [values[[scene["kind"] == kind for scene in found]].mean(0) for kind in kinds]
        means = np.mean(of_kinds, 0)
        scores = [" / ".join(f"{one:.3f}" for one in mean[:3]) for mean in means]
        wins = " / ".join(map(str, (ours[..., 2] > values[..., 2]).sum(0)))
        rows.append([method, *scores, wins if rows else "", f"{means[1, 3]:.0f}"])
    columns = ["boundary recall / under-segmentation error / ASA", *(f"one for {each} points" for each in POINTS)]
    columns += [f"the first has more ASA, of {len(found)} scenes", "ms of a processor for 100,000 points"]
    report.show("superpoints", report.table(columns, rows), arguments.write)
    short = [[*(text.replace(" / ", "/") for text in row[:4]), row[-1]] for row in rows if row[0] in ON_PAGE]
    if arguments.write:
        columns = ["recall/error/ASA", *(f"one for {each} points" for each in POINTS), "ms"]
        report.write_part("compared", report.table(columns, short), PAGE)


if __name__ == "__main__":
    main()
