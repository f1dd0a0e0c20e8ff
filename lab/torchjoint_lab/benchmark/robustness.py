"""How much do labels change if the scene changes a little? Scores the default on disturbed scenes, several times each.

Every run, also of an undisturbed scene, moves the points by noise of its own, because the score of one run is chance.
"""

from __future__ import annotations

import hashlib
import json
import math
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import fmean, stdev
from typing import NamedTuple

import numpy as np
import torch
from torch import Generator, Tensor
from tqdm import tqdm

from torchjoint.joint import JointSegmenter
from torchjoint.metrics import segmentation_covering
from torchjoint.runtime.files import atomic_write, write_text
from torchjoint.scene import Scene
from torchjoint.scene.frame import PoseWarning
from torchjoint_lab.benchmark.disturbances import CLEAN, DISTURBANCES, Disturbed, moved
from torchjoint_lab.benchmark.robustness_scenes import NamedScene
from torchjoint_lab.evaluation.scores import score
from torchjoint_lab.evaluation.table import markdown

#: Metres along each axis, far below the noise of any sensor: what moves the points of every run.
NOISE = 1e-4
#: Frames that are read at a time.
BATCH = 8
#: What a run is scored by, in the order of the table. Covering is that with the first clean run.
MEASURES = ("f", "best_iou", "covering")

Record = Mapping[str, float]


class Run(NamedTuple):
    """One scene with one disturbance, moved by the noise of one number."""

    kind: str
    scene: str
    disturbance: str
    number: int

    @property
    def file(self) -> str:
        """Name of its file of results."""
        return f"{self.scene}.{self.disturbance}.{self.number}.json"

    @property
    def generator(self) -> Generator:
        """A source of random numbers that no other run has."""
        digest = hashlib.sha256(self.file.encode()).digest()
        return Generator().manual_seed(int.from_bytes(digest[:7]))


def measure(
    scenes: Sequence[NamedScene], disturbances: Sequence[str], count: int, folder: Path
) -> Iterator[dict[Run, Record]]:
    """Yields the results of one scene after the other; runs with a file in the folder are not computed again.

    A result is empty if the scene has nothing that the disturbance changes.

    Args:
        scenes: what to measure.
        disturbances: names of DISTURBANCES. The clean runs are always measured, and first.
        count: the number of runs of each disturbance.
        folder: an existing folder.
    """
    names = [CLEAN, *(name for name in disturbances if name != CLEAN)]
    with tqdm(total=len(scenes) * len(names) * count, unit="run") as bar:
        for named in scenes:
            runs = [Run(named.kind, named.name, name, number) for name in names for number in range(count)]
            yield _of_scene(named, runs, folder, bar.update)


def _of_scene(named: NamedScene, runs: Sequence[Run], folder: Path, tell: Callable[[], object]) -> dict[Run, Record]:
    found: dict[Run, Record] = {}
    scene: Scene | None = None
    for run in runs:
        path = folder / run.file
        if not path.is_file():
            scene = scene or named.load()
            write_text(path, json.dumps(_result(run, scene, folder / f"{named.name}.npy")))
        found[run] = json.loads(path.read_text(encoding="utf-8"))
        tell()
    return found


def _result(run: Run, scene: Scene, first: Path) -> Record:
    """Segments a scene, and scores it; `first`: file of the labels of the first clean run, which writes it."""
    if not DISTURBANCES[run.disturbance].applies(scene):
        return {}
    disturbed = disturb(run, scene)
    labels = _segment(disturbed.scene)
    record = scores(labels, disturbed.original, None if scene.truth is None else scene.truth.points)
    if (run.disturbance, run.number) == (CLEAN, 0):
        with atomic_write(first) as partial:
            np.save(partial, labels.numpy())
        return record
    return record | {"covering": covering(labels, disturbed.original, torch.from_numpy(np.load(first)))}


def disturb(run: Run, scene: Scene) -> Disturbed:
    """The scene as the run sees it: disturbed, and then moved."""
    generator = run.generator
    disturbed = DISTURBANCES[run.disturbance](scene, generator)
    points = moved(disturbed.scene.points, NOISE, generator)
    return disturbed._replace(scene=replace(disturbed.scene, points=points))


def _segment(scene: Scene) -> Tensor:
    segmenter = JointSegmenter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PoseWarning)  # poses are wrong on purpose
        segmenter.reset(scene.points, scene.colors, scene.normals)
        for start in range(0, len(scene.frames), BATCH):
            segmenter.update([scene.frames[i] for i in range(start, min(start + BATCH, len(scene.frames)))])
        return segmenter.compute(images=False).points


def scores(labels: Tensor, original: Tensor, truth: Tensor | None) -> dict[str, float]:
    """F and best IoU of the original points that are left; nothing without truth.

    Args:
        labels: [M] of a disturbed scene.
        original: [M] the original points, -1 = added.
        truth: [N] of the original points, -1 = void.
    """
    left = original >= 0
    if truth is None or not (truth[original[left]] >= 0).any():
        return {}
    judged = score(labels[left], truth[original[left]])
    return {"f": judged.f, "best_iou": judged.best_iou}


def covering(labels: Tensor, original: Tensor, clean: Tensor) -> float:
    """Symmetric covering of labels [M] and the labels [N] of a clean run, on the original points that are left."""
    left = original >= 0
    return segmentation_covering(labels[left], clean[original[left]]).symmetric


class Spread(NamedTuple):
    """Mean of a measure over the runs of one kind and disturbance."""

    mean: float
    deviation: float  #: of single runs; NaN for one run
    runs: int

    @property
    def variance(self) -> float:
        """Square of the standard error of the mean."""
        return self.deviation**2 / self.runs

    def __str__(self) -> str:
        return f"{self.mean:.2f}".removeprefix("0")


Table = Mapping[tuple[str, str], Mapping[str, Spread]]  # kind, disturbance -> measure


def spreads(results: Mapping[Run, Record]) -> Table:
    """The spread of each kind, disturbance and measure. A kind's score in one run is the mean over its scenes."""
    by_run: dict[tuple[str, str], dict[str, dict[int, list[float]]]] = {}
    for run, record in results.items():
        for name, value in record.items():
            cell = by_run.setdefault((run.kind, run.disturbance), {})
            cell.setdefault(name, {}).setdefault(run.number, []).append(value)
    return {key: {name: _spread(runs) for name, runs in cell.items()} for key, cell in by_run.items()}


def _spread(runs: Mapping[int, Sequence[float]]) -> Spread:
    means = [fmean(values) for values in runs.values()]
    return Spread(fmean(means), stdev(means) if len(means) > 1 else math.nan, len(means))


def report(results: Mapping[Run, Record]) -> str:
    """Returns the table: one line per disturbance, one column per kind."""
    table = spreads(results)
    kinds = list(dict.fromkeys(run.kind for run in results))
    rows = [
        [DISTURBANCES[name].title, *(_cell(table.get((kind, name), {})) for kind in kinds), *_means(table, kinds, name)]
        for name in dict.fromkeys(run.disturbance for run in results)
    ]
    runs, scenes = (len({getattr(run, name) for run in results}) for name in ("number", "scene"))
    return (
        f"{scenes} scenes, {runs} runs each, whose points moved by {NOISE * 1000:g} mm. F / best IoU against the "
        "truth, covering with the first clean run. The last columns are over the kinds that have what is disturbed: "
        "the mean ± the deviation of single runs of one kind; the difference to the clean runs of the same kinds with "
        "its standard error, bold where it is more than twice that.\n\n"
        + markdown(["disturbance", *kinds, "mean", "mean - clean"], rows)
    )


def _cell(spread: Mapping[str, Spread]) -> str:
    return _joined({name: str(value) for name, value in spread.items()})


def _joined(parts: Mapping[str, str]) -> str:
    """F / best IoU, covering: as many of them as there are."""
    against_truth = " / ".join(parts[name] for name in MEASURES[:2] if name in parts)
    return ", ".join(text for text in (against_truth, parts.get(MEASURES[2], "")) if text) or "–"


def _means(table: Table, kinds: Sequence[str], disturbance: str) -> tuple[str, str]:
    means, differences = {}, {}
    for name in MEASURES:
        both = [[table.get((kind, which), {}).get(name) for which in (disturbance, CLEAN)] for kind in kinds]
        pairs = [(own, clean) for own, clean in both if own is not None and clean is not None]
        if pairs:
            mean, deviation = fmean(own.mean for own, _ in pairs), fmean(own.deviation for own, _ in pairs)
            means[name] = f"{mean:.3f}" if math.isnan(deviation) else f"{mean:.3f} ± {deviation:.3f}"
            differences[name] = _difference(pairs)
    return _joined(means), "" if disturbance == CLEAN else _joined(differences)


def _difference(pairs: Sequence[tuple[Spread, Spread]]) -> str:
    """Mean over kinds of a measure's difference to clean, with the standard error that the runs' deviations give."""
    gain = fmean(own.mean - clean.mean for own, clean in pairs)
    error = math.sqrt(sum(own.variance + clean.variance for own, clean in pairs)) / len(pairs)
    text = f"{round(gain, 3) + 0:+.3f}"  # + 0: no minus sign before a zero
    if math.isnan(error):
        return text
    return f"**{text} ± {error:.3f}**" if abs(gain) > 2 * error else f"{text} ± {error:.3f}"
