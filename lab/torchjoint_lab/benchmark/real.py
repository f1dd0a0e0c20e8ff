"""Scores the default on real recordings (:mod:`real_scenes`), several times each, on moved points.

The rivals are simple methods, each at the best of some settings for the very set that it is scored on.
"""

from __future__ import annotations

import json
import math
import warnings
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from statistics import fmean, stdev
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from torchjoint.config import Config
from torchjoint.joint import JointSegmenter
from torchjoint.metrics import scannet_average_precision, segmentation_covering
from torchjoint.runtime.files import atomic_write, write_text
from torchjoint.scene import Scene
from torchjoint.scene.frame import PoseWarning
from torchjoint.segments.method import Method, scan_method
from torchjoint.segments.scan import method as scan
from torchjoint_lab.benchmark.case import Case
from torchjoint_lab.benchmark.disturbances import moved
from torchjoint_lab.benchmark.methods import METHODS
from torchjoint_lab.benchmark.real_scenes import LIDAR, LabelledScene, RealScene, model_without, with_masks
from torchjoint_lab.benchmark.robustness import BATCH, NOISE
from torchjoint_lab.benchmark.space import Setting, draw
from torchjoint_lab.evaluation.partial_truth import judge
from torchjoint_lab.evaluation.table import markdown

#: Metres along each axis that move the points of a LiDAR scan, about the noise of a sensor.
SCAN_NOISE = 0.01
#: Smallest segment and thing of AP50: ScanNet's, and on scans, whose far things have few points.
LEAST, LEAST_OF_SCAN = 100, 1
#: What a run is scored by, in the order of the table. Covering is that with the first run.
MEASURES = ("f", "best_iou", "ap50", "covering")
#: Sets whose rivals have the parameter ranges of street scans.
OUTDOORS = (*LIDAR, "trees")
RIVALS = ("normals", "distance_normal_color", "ransac_dbscan")

Record = Mapping[str, float]
#: The scores of each run of each scene.
Results = dict[RealScene, list[Record]]


def measure(scenes: Sequence[RealScene], runs: int, folder: Path, scan_models: Path | None = None) -> Iterator[Results]:
    """Yields the default's results, scene by scene; runs with a file in the folder are not computed again.

    With `scan_models`, the folder of `torchjoint-lab train-scan-model`, no scan is judged by a model of its sensor.
    """
    with tqdm(total=len(scenes) * runs, unit="run") as bar:
        for one in scenes:
            method = None
            if scan_models and one.is_scan:
                segment_it = partial(scan.segment, model=scan_models / model_without(one.set))
                method = scan_method()._replace(segment=segment_it)
            yield {one: list(_of_scene(one, runs, folder, method, bar.update))}


def _of_scene(
    one: RealScene, runs: int, folder: Path, method: Method | None, tell: Callable[[], object]
) -> Iterator[Record]:
    labelled: LabelledScene | None = None
    for run in range(runs):
        path = folder / f"{one.name}.{run}.json"
        if not path.is_file():
            labelled = labelled or one.load()
            labels, confidence = segment(as_given(one, labelled, run), method)
            first = labels_of_first(one, folder)
            if run == 0:
                with atomic_write(first) as partial:
                    np.save(partial, labels.numpy().astype(np.int32))
            record = scores(labels, confidence, one, labelled)
            if run:
                clean = torch.from_numpy(np.load(first)).long()
                record["covering"] = segmentation_covering(labels, clean).symmetric
            write_text(path, json.dumps(record))
        tell()
        yield json.loads(path.read_text(encoding="utf-8"))


def labels_of_first(one: RealScene, folder: Path) -> Path:
    """File of the labels of the first run of a scene."""
    return folder / f"{one.name}.npy"


def as_given(one: RealScene, labelled: LabelledScene, run: int) -> Scene:
    """The scene as a run sees it: moved, perhaps with masks, without its truth."""
    scene = with_masks(labelled, one.masks, run) if one.masks else labelled.scene
    noise = SCAN_NOISE if one.is_scan else NOISE
    return replace(scene, points=moved(scene.points, noise, torch.Generator().manual_seed(run)), truth=None)


def segment(scene: Scene, method: Method | None = None) -> tuple[Tensor, Tensor | None]:
    """The default's labels [N], and the confidence of each segment, if it has one."""
    segmenter = JointSegmenter(method=method)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PoseWarning)
        segmenter.reset(scene.points, scene.colors, scene.normals)
        for start in range(0, len(scene.frames), BATCH):
            segmenter.update([scene.frames[i] for i in range(start, min(start + BATCH, len(scene.frames)))])
        result = segmenter.compute(images=False)
    return result.points, result.confidence


def scores(labels: Tensor, confidence: Tensor | None, one: RealScene, labelled: LabelledScene) -> dict[str, float]:
    """F, best IoU and, if a thing is large enough, AP50 of labels [N]."""
    truth = labelled.truth
    judged = judge(labels, truth)
    precision = scannet_average_precision(
        labels[truth.counts],
        truth.instance[truth.counts],
        confidence,
        min_size=LEAST_OF_SCAN if one.is_scan else LEAST,
    )
    found = {"f": judged.f, "best_iou": judged.best_iou, "ap50": precision.ap50}
    return {name: value for name, value in found.items() if not math.isnan(value)}


class Rival(NamedTuple):
    """The best simple method of a set."""

    name: str
    setting: Setting
    runs: list[Record]  #: mean over the scenes in each run


def best_rival(scenes: Sequence[RealScene], settings: int, runs: int, folder: Path) -> Rival:
    """The simple method with the best (F + best IoU) / 2 over the scenes of one set, at its best random setting.

    Args:
        scenes: of one set, without masks.
        settings: number of random settings of each method.
        runs: of the best one, on points that move as the default's do.
        folder: of the scores that are known.
    """
    cases = [_Prepared(one) for one in scenes]
    tried = [
        (name, setting, _mean_scores(cases, name, setting, 0, folder / f"{scenes[0].set}.{name}.{number}.json"))
        for name in RIVALS
        for number, setting in enumerate(_settings(name, scenes[0], settings))
    ]
    name, setting, first = max(tried, key=lambda one: one[2]["f"] + one[2]["best_iou"])
    path = folder / f"{scenes[0].set}.{name}.best"
    more = [
        _mean_scores(cases, name, setting, run, path.with_name(f"{path.name}.{run}.json")) for run in range(1, runs)
    ]
    return Rival(name, setting, [first, *more])


def _settings(name: str, one: RealScene, count: int) -> list[Setting]:
    space = METHODS[name].space_in("kitti" if one.set in OUTDOORS else "")
    random = np.random.default_rng(zlib.crc32(name.encode()))
    return [draw(space, random) for _ in range(count)]


class _Prepared:
    """A scene that is read once, and moved once for each run."""

    def __init__(self, one: RealScene) -> None:
        self.scene = one
        self._labelled: LabelledScene | None = None
        self._case: tuple[int, Case] | None = None

    @property
    def labelled(self) -> LabelledScene:
        self._labelled = self._labelled or self.scene.load()
        return self._labelled

    def case(self, run: int) -> Case:
        """What the methods of the benchmark take."""
        if self._case is None or self._case[0] != run:
            self._case = run, Case(as_given(self.scene, self.labelled, run), Config())
        return self._case[1]


def _mean_scores(cases: Sequence[_Prepared], name: str, setting: Setting, run: int, path: Path) -> Record:
    """Mean over the scenes of the scores of a method, from the file if it exists."""
    if not path.is_file():
        found = []
        for one in cases:
            labels = METHODS[name].run(one.case(run), setting, False).points
            assert labels is not None
            found.append(scores(labels, None, one.scene, one.labelled))
        write_text(path, json.dumps(_mean(found)))
    record: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return record


def report(results: Results, rivals: Mapping[str, Rival]) -> str:
    """Returns the table: a row for each set, and means over the sets without masks, of LiDAR, and with masks."""
    sets = list(dict.fromkeys(one.set for one in results))
    of_set = {name: _means(results, [one for one in results if one.set == name]) for name in sets}
    count = {name: sum(one.set == name for one in results) for name in sets}
    rows = [[f"{name}, {count[name]}", _cell(of_set[name]), _rival_cell(rivals.get(name))] for name in sets]
    masked = {one.set for one in results if one.masks}
    groups = {
        "mean of the sets without LiDAR": [name for name in sets if name not in masked and name not in LIDAR],
        "mean of LiDAR": [name for name in sets if name in LIDAR],
        "mean with masks": [name for name in sets if name in masked],
    }
    for title, names in groups.items():
        if names:
            known = [rivals[name] for name in names if name in rivals]
            of_rivals = _cell(_mean_of([one.runs for one in known])) if len(known) == len(names) else ""
            rows.append([f"**{title}**", _cell(_mean_of([of_set[name] for name in names])), of_rivals])
    return markdown(["set, scenes", "default", "best simple method, tuned on the set"], rows)


def _means(results: Results, scenes: Sequence[RealScene]) -> list[Record]:
    """For each run the mean of each score over some scenes."""
    return _mean_of([results[one] for one in scenes])


def _mean_of(tables: Sequence[Sequence[Record]]) -> list[Record]:
    """For each run the mean over several tables of runs."""
    return [_mean(run) for run in zip(*tables, strict=True)]


def _mean(records: Sequence[Record]) -> Record:
    """The mean of each score over the records that have it."""
    have = {name: [one[name] for one in records if name in one] for name in MEASURES}
    return {name: fmean(values) for name, values in have.items() if values}


def _cell(runs: Sequence[Record]) -> str:
    """Mean ± deviation of the runs, of each measure."""
    return " / ".join(
        _mean_and_deviation([run[name] for run in runs if name in run])
        for name in MEASURES
        if any(name in run for run in runs)
    )


def _mean_and_deviation(values: Sequence[float]) -> str:
    deviation = stdev(values) if len(values) > 1 else math.nan
    mean = f"{fmean(values):.3f}"
    return mean if math.isnan(deviation) else f"{mean} ± {deviation:.3f}"


def _rival_cell(rival: Rival | None) -> str:
    return "" if rival is None else f"{_cell(rival.runs)} ({rival.name})"


def worst_scenes(results: Results) -> list[RealScene]:
    """Of each set without masks, the scene with the lowest mean of F and best IoU."""
    worst: dict[str, RealScene] = {}
    for one, runs in results.items():
        if not one.masks and (one.set not in worst or _quality(runs) < _quality(results[worst[one.set]])):
            worst[one.set] = one
    return list(worst.values())


def _quality(runs: Sequence[Record]) -> float:
    return fmean(run["f"] + run["best_iou"] for run in runs)
