"""Judges the default on scans of several sensors, real and generated, beside TRAVEL and ground removal with DBSCAN.

`python lab/studies/sensors.py --data FOLDER --simple 40 --travel PYTHON --write` makes tables in docs/evaluation.md.
FOLDER has `kitti/`, `semantickitti/`, `vod/`, `argo/` and `nuscenes/`. PYTHON is the interpreter of an environment with
`pip install travel-seg pypatchworkpp` (GPL, BSD), which are run as programs. Scores are those of streets.py, of runs on
points that are moved by 1 cm.
"""

from __future__ import annotations

import argparse
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
from streets import Sweep, best_simple, kitti, known_instances, run, semantickitti, street
from torch import Tensor
from torchjoint_lab.benchmark.disturbances import moved
from torchjoint_lab.benchmark.planes import planes_and_clusters
from torchjoint_lab.synthetic import LIDARS

from torchjoint.datasets import list_scenes, load_scene
from torchjoint.segments.scan.one_view import look_for_scan
from torchjoint.segments.scan.scan_segments import segment_scan

#: Metres along each axis, about the noise of a sensor: what moves the points of each run; and the number of runs.
NOISE, RUNS = 0.01, 4
#: Seeds of streets. On 41 and 44 settings of small segments were compared; on the others nothing was chosen.
STREETS = range(40, 60)
EVALUATION = Path(__file__).parents[2] / "docs" / "evaluation.md"
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
    parser.add_argument("--streets", type=int, default=6, metavar="COUNT", help="generated streets of each sensor")
    report.add_write(parser, "the tables in docs/evaluation.md")
    arguments = parser.parse_args()
    loaders = {"kitti": kitti, "semantickitti": semantickitti, "nuscenes": nuscenes}
    columns, rows = ["method"], dict[str, list[str]]()
    for name, title in SENSORS.items():
        sweeps = list(loaders[name](arguments.data) if name in loaders else plain(name, arguments.data))
        methods: dict[str, Callable[[Tensor], Tensor]] = {"default": segment_scan}
        if arguments.travel:
            methods["TRAVEL"] = partial(travel, arguments.travel)
        if arguments.travel and arguments.simple:
            methods["Patchwork++ and DBSCAN, tuned on the column"] = best_patchwork(arguments.travel, sweeps)
        if arguments.simple:
            setting = best_simple(sweeps, arguments.simple)[1]
            methods["planes and DBSCAN, tuned on the column"] = partial(planes_and_clusters, **setting)
        things = sum(int((one.instance.unique() >= 0).sum()) for one in sweeps)
        columns.append(f"{title}: {len(sweeps)}, {things} things")
        for method, function in methods.items():
            rows.setdefault(method, []).append(cell(function, sweeps))
            print(name, method, rows[method][-1], flush=True)
    tables = {"sensors": report.table(columns, [[method, *cells] for method, cells in rows.items()])}
    tables["generated sensors"] = of_generated(arguments.streets, arguments.travel)
    for part, text in tables.items():
        print(text)
        if arguments.write:
            report.write_part(part, text, EVALUATION)


def of_generated(count: int, python: Path | None) -> str:
    """The default, and TRAVEL, on the same streets as each kind of sensor sees them."""
    methods: dict[str, Callable[[Tensor], Tensor]] = {"default": segment_scan}
    if python:
        methods["TRAVEL"] = partial(travel, python)
    rows = []
    for kind in LIDARS:
        sweeps = [street(seed, kind) for seed in STREETS[:count]]
        recognised = sum(look_for_scan(sweep.points).is_scan for sweep in sweeps)
        rows.append([kind, f"{recognised} of {len(sweeps)}", *(cell(method, sweeps) for method in methods.values())])
        print(*rows[-1], flush=True)
    return report.table(["sensor", "recognised", *methods], rows)


def plain(name: str, data: Path) -> Iterator[Sweep]:
    """A cloud with things in boxes; -2 is what counts where it leaks into a thing."""
    truth = torch.from_numpy(np.load(data / name / "cloud.truth.npy")).long()
    points = load_scene(data / name / "cloud.ply").points
    yield Sweep(name, points, truth.clamp(min=-1), truth == -2, None)


def nuscenes(data: Path) -> Iterator[Sweep]:
    """Points in boxes; what is outside all boxes is void."""
    for name, path in list_scenes(data / "nuscenes").items():
        scene = load_scene(path)
        instance = known_instances(scene)
        yield Sweep(name, scene.points, instance, torch.zeros_like(instance, dtype=torch.bool), None)


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


def best_patchwork(python: Path, sweeps: list[Sweep]) -> Callable[[Tensor], Tensor]:
    """Patchwork++ and DBSCAN at the best of all settings for these very scans; (F + best IoU) / 2."""
    methods = [partial(patchwork, python, *setting) for setting in product(HEIGHTS, RADII, LEAST)]

    def quality(method: Callable[[Tensor], Tensor]) -> float:
        scores = [run(method, sweep) for sweep in sweeps]
        return fmean(score.f + score.best_iou for score in scores)

    return max(methods, key=quality)


def cell(method: Callable[[Tensor], Tensor], sweeps: list[Sweep]) -> str:
    """F / best IoU / share found: means over the scans of RUNS runs, and the deviation of these means."""
    of_runs = []
    for number in range(RUNS):
        scores = []
        for sweep in sweeps:
            points = moved(sweep.points, NOISE, torch.Generator().manual_seed(number))
            scores.append(run(method, sweep._replace(points=points)))
        of_runs.append([fmean(getattr(score, name) for score in scores) for name in ("f", "best_iou", "found")])
    mean, spread = np.mean(of_runs, 0), np.std(of_runs, 0, ddof=1)
    return " / ".join(f"{value:.3f} ± {error:.3f}" for value, error in zip(mean, spread, strict=True))


if __name__ == "__main__":
    main()
