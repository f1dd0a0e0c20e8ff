"""Judges the default on scans of several sensors, real and generated, beside TRAVEL and ground removal with DBSCAN.

`python lab/studies/sensors.py --data FOLDER --simple 40 --travel PYTHON --write` makes tables in lab/studies/lidar.md.
FOLDER has `kitti/`, `semantickitti/`, `vod/`, `argo/` and `nuscenes/`. PYTHON is the interpreter of an environment with
`pip install travel-seg pypatchworkpp` (GPL, BSD), which are run as programs. Scores are those of streets.py, and AP50
as in ScanNet's benchmark, of runs on points that are moved by 1 cm. With `--done FILE` a cell that was measured is not
measured again.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from itertools import product
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np
import report
import torch
from numpy.typing import NDArray
from sklearn.cluster import DBSCAN
from streets import Sweep, best_simple, judge, kitti, known_instances, run, semantickitti, street
from torch import Tensor
from torchjoint_lab.benchmark.disturbances import moved
from torchjoint_lab.benchmark.planes import planes_and_clusters
from torchjoint_lab.benchmark.real_scenes import model_without
from torchjoint_lab.synthetic import LIDARS

from torchjoint.datasets import list_scenes, load_scene
from torchjoint.metrics import ScannetAveragePrecisionMetric
from torchjoint.segments.scan.method import segment_levels
from torchjoint.segments.scan.recognition import look_for_scan

#: Labels [N] of points [N, 3]; -1 = none.
Method = Callable[[Tensor], Tensor]

#: Metres along each axis, about the noise of a sensor: what moves the points of each run; and the number of runs.
NOISE, RUNS = 0.01, 4
#: Seeds of streets. On 41 and 44 settings of small segments were compared; on the others nothing was chosen.
STREETS = range(40, 60)
PAGE = Path(__file__).parent / "lidar.md"
#: The sensors of the data with things in boxes or a full annotation.
SENSORS = {
    "kitti": "KITTI, in the image",
    "semantickitti": "SemanticKITTI, a sweep",
    "vod": "View of Delft, in the image",
    "argo": "Argoverse 2, two sensors",
    "nuscenes": "nuScenes, a sweep",
}
#: Settings of Patchwork++ and DBSCAN: heights of the sensor, metres; radius, metres, and least number of points.
HEIGHTS, RADII, LEAST = (0.3, 1.2, 1.75), (0.3, 0.5, 0.8), (1, 3, 6)
#: What the other interpreter runs: a file of points, a file for what is found. Logs go to stdout.
TRAVEL = """
import sys
import numpy as np
import travel_seg
found = travel_seg.segment(np.load(sys.argv[1]))
np.savez(sys.argv[2], ground=found.ground_mask, thing=found.instance_labels)
"""
PATCHWORK = """
import sys
import numpy as np
import pypatchworkpp
parameters = pypatchworkpp.Parameters()
parameters.sensor_height = float(sys.argv[3])
parameters.enable_RNR = False  # there are no intensities
parameters.max_range = 200.0
found = pypatchworkpp.patchworkpp(parameters)
found.estimateGround(np.load(sys.argv[1]))
np.savez(sys.argv[2], ground=found.getGroundIndices())
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="folder with those of SENSORS")
    parser.add_argument("--simple", type=int, default=0, metavar="COUNT", help="tries plane removal + DBSCAN")
    parser.add_argument("--travel", type=Path, metavar="PYTHON", help="interpreter of the peers")
    parser.add_argument("--models", type=Path, help="folder of train-scan-model: no scan by a model of its sensor")
    parser.add_argument("--streets", type=int, default=6, metavar="COUNT", help="generated streets of each sensor")
    parser.add_argument("--done", type=Path, metavar="FILE", help="cells that were measured, JSON")
    report.add_write(parser, "the tables in lab/studies/lidar.md")
    arguments = parser.parse_args()
    cells = Cells(arguments.done)
    loaders = {"kitti": kitti, "semantickitti": semantickitti, "nuscenes": nuscenes}
    columns, rows = ["method"], dict[str, list[str]]()
    for name, title in SENSORS.items():
        sweeps = list(loaders[name](arguments.data) if name in loaders else plain(name, arguments.data))
        model = arguments.models and arguments.models / model_without(name)
        methods: dict[str, Callable[[], Method]] = {"default": lambda model=model: partial(segment, model)}
        if arguments.travel:
            methods["TRAVEL"] = lambda: partial(travel, arguments.travel)
        if arguments.travel and arguments.simple:
            tuned = partial(best_patchwork, arguments.travel, sweeps)
            methods["Patchwork++ and DBSCAN, tuned on the column"] = tuned
        if arguments.simple:
            methods["planes and DBSCAN, tuned on the column"] = partial(best_planes, sweeps, arguments.simple)
        things = sum(int((one.instance.unique() >= 0).sum()) for one in sweeps)
        columns.append(f"{title}: {len(sweeps)}, {things} things")
        for method, made in methods.items():
            rows.setdefault(method, []).append(cells.get(f"{name}, {method}", made, sweeps))
    tables = {"sensors": report.table(columns, [[method, *found] for method, found in rows.items()])}
    tables["generated sensors"] = of_generated(arguments.streets, arguments.travel, cells)
    for part, text in tables.items():
        print(text)
        if arguments.write:
            report.write_part(part, text, PAGE)


class Cells:
    """The cells of the tables that were measured; they are kept in a file, if there is one."""

    def __init__(self, file: Path | None) -> None:
        self._file = file
        self._cells: dict[str, str] = json.loads(file.read_text()) if file and file.is_file() else {}

    def get(self, name: str, method: Callable[[], Method], sweeps: list[Sweep]) -> str:
        """The cell of this name; it is measured if it was not."""
        if name not in self._cells:
            self._cells[name] = cell(method(), sweeps)
            print(name, self._cells[name], flush=True)
            if self._file:
                self._file.write_text(json.dumps(self._cells, indent=0))
        return self._cells[name]


def of_generated(count: int, python: Path | None, cells: Cells) -> str:
    """The default, and TRAVEL, on the same streets as each kind of sensor sees them."""
    methods: dict[str, Callable[[], Method]] = {"default": lambda: lambda points: segment_levels(points).at()}
    if python:
        methods["TRAVEL"] = lambda: partial(travel, python)
    rows = []
    for kind in LIDARS:
        sweeps = [street(seed, kind) for seed in STREETS[:count]]
        recognised = sum(look_for_scan(sweep.points).is_scan for sweep in sweeps)
        found = [cells.get(f"{kind}, {name}", made, sweeps) for name, made in methods.items()]
        rows.append([kind, f"{recognised} of {len(sweeps)}", *found])
    return report.table(["sensor", "recognised", *methods], rows)


def segment(model: Path | None, points: Tensor) -> Tensor:
    """The default's labels [N], with the packaged model or with that of a file."""
    return segment_levels(points, model=model).at()


def plain(name: str, data: Path) -> Iterator[Sweep]:
    """A cloud with things in boxes; -2 is what counts where it leaks into a thing."""
    truth = torch.from_numpy(np.load(data / name / "cloud.truth.npy")).long()
    points = load_scene(data / name / "cloud.ply").points
    yield Sweep(name, points, truth.clamp(min=-1), truth == -2)


def nuscenes(data: Path) -> Iterator[Sweep]:
    """Points in boxes; what is outside all boxes is void."""
    for name, path in list_scenes(data / "nuscenes").items():
        scene = load_scene(path)
        instance = known_instances(scene)
        yield Sweep(name, scene.points, instance, torch.zeros_like(instance, dtype=torch.bool))


def travel(python: Path, points: Tensor) -> Tensor:
    """Labels [N] of TRAVEL (M. Oh et al., RA-L 2022): 0 ground, -1 none."""
    found = other_program(python, TRAVEL, points)
    thing = torch.from_numpy(found["thing"].astype(np.int64))
    return torch.where(torch.from_numpy(found["ground"].astype(bool)), 0, torch.where(thing > 0, thing, -1))


def other_program(python: Path, code: str, points: Tensor, *arguments: str) -> dict[str, NDArray[Any]]:
    """The arrays that a program makes of points, which get an intensity of 0."""
    with tempfile.TemporaryDirectory() as folder:
        given, made = Path(folder) / "points.npy", Path(folder) / "found.npz"
        np.save(given, np.pad(points.float().numpy(), ((0, 0), (0, 1))))
        subprocess.run([str(python), "-c", code, str(given), str(made), *arguments], check=True, capture_output=True)
        with np.load(made) as found:
            return dict(found)


def patchwork(python: Path, height: float, radius: float, least: int, points: Tensor) -> Tensor:
    """Labels [N] of Patchwork++ (S. Lee et al., IROS 2022) and DBSCAN of what is not ground: 0 ground, -1 none."""
    labels = torch.full((len(points),), -1)
    labels[torch.from_numpy(other_program(python, PATCHWORK, points, str(height))["ground"].astype(np.int64))] = 0
    rest = torch.nonzero(labels < 0).flatten()
    cluster = DBSCAN(eps=radius, min_samples=least).fit_predict(points[rest].numpy())
    labels[rest] = torch.from_numpy(cluster + (cluster >= 0)).long()
    return labels


def best_planes(sweeps: list[Sweep], count: int) -> Method:
    """Plane removal and DBSCAN at the best of `count` settings for these very scans."""
    return partial(planes_and_clusters, **best_simple(sweeps, count)[1])


def best_patchwork(python: Path, sweeps: list[Sweep]) -> Method:
    """Patchwork++ and DBSCAN at the best of all settings for these very scans; (F + best IoU) / 2."""
    methods = [partial(patchwork, python, *setting) for setting in product(HEIGHTS, RADII, LEAST)]

    def quality(method: Method) -> float:
        scores = [run(method, sweep) for sweep in sweeps]
        return fmean(score.f + score.best_iou for score in scores)

    return max(methods, key=quality)


def cell(method: Method, sweeps: list[Sweep]) -> str:
    """F / best IoU / share found / AP50: means over the scans of RUNS runs, and the deviation of these means.

    AP50 is that of all scans together. All segments have the same score. Where things are unknown, points do not count;
    segments of which most are houses and the like are no false positives.
    """
    of_runs = []
    for number in range(RUNS):
        scores, precision = [], ScannetAveragePrecisionMetric(min_size=1)
        for sweep in sweeps:
            labels = method(moved(sweep.points, NOISE, torch.Generator().manual_seed(number)))
            scores.append(judge(labels, sweep))
            counts = (sweep.instance >= 0) | sweep.other
            precision.update(labels[counts], sweep.instance[counts])
        means = [fmean(getattr(score, name) for score in scores) for name in ("f", "best_iou", "found")]
        of_runs.append([*means, precision.compute().ap50])
    mean, spread = np.mean(of_runs, 0), np.std(of_runs, 0, ddof=1)
    return " / ".join(f"{value:.3f} ± {error:.3f}" for value, error in zip(mean, spread, strict=True))


if __name__ == "__main__":
    main()
