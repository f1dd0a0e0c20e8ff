"""Compares ways of bringing a network's masks to 3D, on generated scenes with masks of several levels of error.

Each seed makes other masks, and moves the points by far less than a sensor's noise, because the score of one run is
chance.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property, lru_cache
from pathlib import Path
from statistics import fmean, stdev
from typing import Any, NamedTuple

import torch
from torch import Tensor
from tqdm import tqdm

from torchjoint.config import Config
from torchjoint.joint import JointSegmenter
from torchjoint.oversegmentation import superpoints
from torchjoint.runtime.files import write_text
from torchjoint.scene import Scene
from torchjoint.scene.masks import Masks
from torchjoint_lab.benchmark.case import Case
from torchjoint_lab.benchmark.disturbances import moved
from torchjoint_lab.benchmark.mask_merging.mask_clustering import mask_clustering
from torchjoint_lab.benchmark.mask_merging.sai3d import sai3d
from torchjoint_lab.benchmark.mask_merging.sam3d import sam3d
from torchjoint_lab.benchmark.robustness import NOISE
from torchjoint_lab.benchmark.vote import vote
from torchjoint_lab.evaluation.scores import score, score_images
from torchjoint_lab.evaluation.table import markdown, standard_error
from torchjoint_lab.synthetic import MASK_LEVELS, make_domain_scene, with_network_masks

#: Images of the scenes of each domain.
VIEWS = {"room": 30, "table": 12, "shelf": 15}
#: First seeds of the scenes. On the scenes for checking nothing was chosen.
FIRST_SEED = {"tuning": 20, "checking": 100}
TITLES = {
    "ours": "joint",
    "sai3d": "SAI3D",
    "mask_clustering": "MaskClustering",
    "sam3d": "SAM3D",
    "vote": "masks, voted",
}

Record = dict[str, Any]


class Run(NamedTuple):
    """A scene with points moved by the noise of a seed, and masks of one level of this seed."""

    domain: str
    scene: int
    noise: int
    level: str

    @property
    def file(self) -> str:
        """Name of its file of results."""
        return f"{self.domain}-{self.scene}-{self.noise}-{self.level}.json"


class Prepared:
    """A scene, and what several methods need of it, timed once: it does not depend on the masks."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.case = Case(scene, Config())

    @cached_property
    def visibility_seconds(self) -> float:
        """Seconds for the visible points of all frames."""
        return _timed(lambda: self.case.visible)[1]

    @cached_property
    def superpoints(self) -> tuple[Tensor, float]:
        """Superpoints [N], and the seconds that they took."""
        return _timed(lambda: superpoints(self.scene.points, self.scene.colors))


def runs(half: str, num_scenes: int, num_noises: int, domains: Sequence[str] = tuple(VIEWS)) -> list[Run]:
    """Returns all runs, scene by scene.

    Raises:
        ValueError: an unknown domain, or a number below 1.
    """
    for name, count in (("--scenes", num_scenes), ("--noise-seeds", num_noises)):
        if count < 1:
            raise ValueError(f"{name}: expected at least 1, got {count}")
    if unknown := [domain for domain in domains if domain not in VIEWS]:
        raise ValueError(f"--domains: expected some of {', '.join(VIEWS)}, got {unknown[0]!r}")
    return [
        Run(domain, FIRST_SEED[half] + index, noise, level)
        for domain in domains
        for index in range(num_scenes)
        for noise in range(num_noises)
        for level in MASK_LEVELS
    ]


def measure(todo: Sequence[Run], methods: Sequence[str], folder: Path) -> Iterator[tuple[Run, dict[str, Record]]]:
    """Yields the results of each run, by method; runs with a file in the folder are not computed again."""
    make = lru_cache(maxsize=1)(lambda domain, seed: make_domain_scene(domain, seed, num_views=VIEWS[domain]).scene)
    prepared: tuple[Run, Prepared] | None = None
    for run in tqdm(todo, unit="run"):
        path = folder / run.file
        found: dict[str, Record] = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
        missing = [name for name in methods if name not in found]
        if missing and (prepared is None or prepared[0][:3] != run[:3]):
            generator = torch.Generator().manual_seed(run.noise)
            made = make(run.domain, run.scene)
            prepared = run, Prepared(replace(made, points=moved(made.points, NOISE, generator)))
        if missing and prepared is not None:
            masked = with_network_masks(prepared[1].scene, run.level, run.noise)
            for name in missing:
                found[name] = _result(name, prepared[1], masked)
                write_text(path, json.dumps(found, indent=1))
        yield run, {name: found[name] for name in methods}


def _result(name: str, prepared: Prepared, masked: Scene) -> Record:
    """Scores in 3D and, of ours and of the masks themselves, in the images; seconds from masks to labels in 3D."""
    truth, masks = masked.truth, [frame.masks for frame in masked.frames if isinstance(frame.masks, Masks)]
    assert truth is not None
    assert truth.points is not None
    images: Sequence[Tensor] | None = None
    if name == "ours":
        segmenter, labels, seconds = _joint(masked)
        images = segmenter.compute().images
    else:
        labels, seconds = _rival(name, prepared, masks)
        images = [of_frame.labels() for of_frame in masks] if name == "vote" else None
    in_3d = score(labels, truth.points)
    record: Record = {"seconds": seconds, "3D": [in_3d.covering, in_3d.f, in_3d.best_iou]}
    if images is not None and (in_2d := score_images(images, truth.images)) is not None:
        record["2D"] = [in_2d.covering, in_2d.f, in_2d.best_iou]
    return record


def _joint(masked: Scene) -> tuple[JointSegmenter, Tensor, float]:
    segmenter = JointSegmenter()

    def run() -> Tensor:
        segmenter.reset(masked.points, masked.colors, masked.normals)
        for start in range(0, len(masked.frames), 8):
            segmenter.update(masked.frames[start : start + 8])
        return segmenter.compute(images=False).points

    return segmenter, *_timed(run)


def _rival(name: str, prepared: Prepared, masks: Sequence[Masks]) -> tuple[Tensor, float]:
    points, seconds, visible = prepared.scene.points, prepared.visibility_seconds, prepared.case.visible
    if name in ("sai3d", "sam3d"):
        of_point, more = prepared.superpoints
        merge = sai3d if name == "sai3d" else sam3d
        labels, own = _timed(lambda: merge(points, visible, masks, of_point))
        return labels, seconds + more + own
    if name == "mask_clustering":
        labels, own = _timed(lambda: mask_clustering(points, visible, masks))
    else:
        labels, own = _timed(lambda: vote([of_frame.labels() for of_frame in masks], visible, points))
    return labels, seconds + own


def _timed(function: Callable[[], Any]) -> tuple[Any, float]:
    start = time.perf_counter()
    with torch.no_grad():
        result = function()
    return result, time.perf_counter() - start


def report(results: Sequence[tuple[Run, dict[str, Record]]], half: str) -> str:
    """Returns the table: one line per domain, level and method.

    The noise seeds of a scene are averaged first, because they are not independent. The deviation of a mean is that of
    the seeds' means; errors of differences are over the scenes.
    """
    body = []
    for domain in dict.fromkeys(run.domain for run, _ in results):
        for level in dict.fromkeys(run.level for run, _ in results):
            of_level = [(run, found) for run, found in results if (run.domain, run.level) == (domain, level)]
            for method in of_level[0][1]:
                body.append([f"{domain}, {level}", TITLES[method], *_cells(of_level, method)])
    scenes = len({(run.domain, run.scene) for run, _ in results})
    noises = len({run.noise for run, _ in results})
    columns = ["", "", "3D SSC / F / best IoU", "joint - it: F", "joint - it: best IoU", "2D F / best IoU", "seconds"]
    return (
        f"{scenes} {half} scenes, {noises} runs each, with other masks and points moved by {1000 * NOISE:g} mm. Means, "
        "and the deviation of the runs; differences are paired by scene, with their standard errors, bold where they "
        "are more than twice that. Seconds are from the masks to the "
        "labels in 3D, with visibility, and with superpoints where they are used.\n\n" + markdown(columns, body)
    )


def _cells(of_level: Sequence[tuple[Run, dict[str, Record]]], method: str) -> list[str]:
    in_3d = [_mean_and_deviation(of_level, method, "3D", index) for index in range(3)]
    in_2d = [_mean_and_deviation(of_level, method, "2D", index) for index in (1, 2)]
    seconds = fmean(found[method]["seconds"] for _, found in of_level)
    has_both = method != "ours" and "ours" in of_level[0][1]
    gains = [_gain(of_level, method, index) if has_both else "" for index in (1, 2)]
    return [
        " / ".join(in_3d),
        *gains,
        " / ".join(filter(None, in_2d)),
        f"{seconds:.1f}",
    ]


def _mean_and_deviation(of_level: Sequence[tuple[Run, dict[str, Record]]], method: str, space: str, index: int) -> str:
    """Over the seeds, of their means over the scenes; "" if the method has no such scores."""
    values: dict[int, list[float]] = {}
    for run, found in of_level:
        if space in found[method]:
            values.setdefault(run.noise, []).append(found[method][space][index])
    means = [fmean(of_seed) for of_seed in values.values()]
    if not means:
        return ""
    return f"{fmean(means):.3f}" + (f" ± {stdev(means):.3f}" if len(means) > 1 else "")


def _gain(of_level: Sequence[tuple[Run, dict[str, Record]]], method: str, index: int) -> str:
    ours, theirs = (_mean(of_level, name, "3D", index) for name in ("ours", method))
    differences = [own - other for own, other in zip(ours, theirs, strict=True)]
    mean, error = fmean(differences), standard_error(differences)
    text = f"{round(mean, 3) + 0:+.3f}"  # + 0: no minus sign before a zero
    if len(differences) == 1:
        return text
    return f"**{text} ± {error:.3f}**" if abs(mean) > 2 * error else f"{text} ± {error:.3f}"


def _mean(of_level: Sequence[tuple[Run, dict[str, Record]]], method: str, space: str, index: int) -> list[float]:
    """Per scene the mean over the noise seeds; empty if the method has no such scores."""
    values: dict[int, list[float]] = {}
    for run, found in of_level:
        if space in found[method]:
            values.setdefault(run.scene, []).append(found[method][space][index])
    return [fmean(of_scene) for of_scene in values.values()]
