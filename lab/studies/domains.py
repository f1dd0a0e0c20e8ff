"""Does the model of boundaries carry over? Leaves each kind of data out of the training, and scores it there.

    python lab/studies/domains.py WORK --data ../shared/data [--models FOLDER] [--seeds 5] [--draws 8 --steps 4]
        [--runs 4] [--kinds KIND ...] [--scenes COUNT] [--write]

For each kind of data and each training seed, a model is trained on all other kinds; each, and their mean, is scored on
scenes of the kind that they never saw, at the threshold of .5. Beside it: the model that saw scenes of all kinds, the
same without images, the presets, and the common methods without learning, each at the best setting that a search finds
on other scenes of the very kind that it is scored on. Also: the final images beside the initial ones. Each scene is
scored --runs times, with points that are moved by .1 mm, because the score of one run is chance. WORK keeps what is
done, so that an interrupted run continues. The tables are printed; --write also puts them into
lab/studies/README.md. Without 3D models, the generated scenes
have built-in shapes only.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import report
import torch
from domain_tables import PRESETS, SIMPLE, show_tables
from torch import Tensor
from torchjoint_lab.benchmark.case import Case
from torchjoint_lab.benchmark.disturbances import moved
from torchjoint_lab.benchmark.methods import METHODS
from torchjoint_lab.benchmark.robustness import NOISE
from torchjoint_lab.benchmark.search import Budget, run_scores, search
from torchjoint_lab.evaluation.scores import score, score_images
from torchjoint_lab.synthetic import make_domain_scene
from torchjoint_lab.training import save_boundary_model
from torchjoint_lab.training.boundary_examples import (
    BoundaryModelOptions,
    LabelledEvidence,
    labelled_evidence,
    learned_config,
)
from torchjoint_lab.training.boundary_model import fit_boundary_model
from torchjoint_lab.training.superpoint_graph_files import load_evidence, save_evidence

import torchjoint as tj
from torchjoint.runtime.files import write_text
from torchjoint.runtime.threads import one_thread_per_operation
from torchjoint.scene import Scene
from torchjoint.scene.scene import voxel_subsample
from torchjoint.segments.learned.boundary_model import BoundaryModel, load_boundary_model
from torchjoint.segments.learned.consensus import build_consensus

DOMAINS = ("table", "shelf", "bin", "desk", "kitchen", "room", "workshop")
#: Seeds of the generated scenes for training, for tuning the other methods (a part of these), and for scoring. The
#: things of the scenes for scoring are of kinds that no other scene has (`held_out`).
TRAINING, TUNING, SCORING = (*range(10), *range(14, 24)), range(4), (*range(10, 14), *range(40, 44))
#: mOSD: every other scene trains, the others score. The real desk is never trained on.
REAL = ("mosd", "ycb")
#: What is left out of the training, and what the model is scored on: the real desk is of the kind "desk".
LEFT_OUT = {**{kind: (kind,) for kind in (*DOMAINS, "mosd")}, "desk": ("desk", "ycb")}
#: As the model in the package was trained, but for fewer folds and fewer scenes, which take less time.
OPTIONS = BoundaryModelOptions(folds=2)
#: Frames held in memory at a time.
FRAMES = 8


class Named(NamedTuple):
    """A scene that is made or read when it is needed."""

    name: str
    load: Callable[[], Scene]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("work", type=Path)
    parser.add_argument("--data", type=Path, required=True, help="folder with mosd/ and ycb/")
    parser.add_argument("--models", type=Path, help="folder of 3D models for the generated scenes")
    parser.add_argument("--seeds", type=int, default=5, help="training seeds of each left-out model")
    parser.add_argument("--runs", type=int, default=4, help="runs of each scene, on moved points")
    parser.add_argument("--draws", type=int, default=8)
    parser.add_argument("--steps", type=int, default=4)
    parser.add_argument("--kinds", nargs="+", choices=(*DOMAINS, *REAL), default=(*DOMAINS, *REAL), help="only these")
    parser.add_argument("--scenes", type=int, metavar="COUNT", help="at most so many of each kind for each purpose")
    parser.add_argument("--part", choices=("all", "left-out", "default", "others", "images", "tables"), default="all")
    report.add_write(parser, "the tables in lab/studies/README.md")
    arguments = parser.parse_args()
    work: Path = arguments.work
    check(parser, arguments)
    kinds = [kind for kind in (*DOMAINS, *REAL) if kind in arguments.kinds]
    left_out_kinds = [kind for kind in LEFT_OUT if kind in kinds]
    if arguments.part in ("all", "left-out"):
        prepare(arguments)
        for seed in range(arguments.seeds):
            for kind in left_out_kinds:
                score_left_out(work, kind, str(seed), left_out_model(work, kind, seed, arguments), arguments)
        for kind in left_out_kinds:
            models = [left_out_model(work, kind, seed, arguments) for seed in range(arguments.seeds)]
            mean = BoundaryModel(tuple(member for model in models for member in model.members))
            score_left_out(work, kind, f"mean{len(models)}", mean, arguments)
    if arguments.part in ("all", "default"):
        for kind in kinds:
            score_default(work, kind, arguments)
    if arguments.part in ("all", "others"):
        for kind in kinds:
            score_others(work, kind, arguments)
    if arguments.part in ("all", "images"):
        for kind in kinds:
            score_final_images(work, kind, arguments)
    show_tables(work, kinds, arguments.runs, arguments.write)


def check(parser: argparse.ArgumentParser, arguments: argparse.Namespace) -> None:
    """Ends with a message if an argument is wrong, or if WORK has the results of other scenes."""
    for name, least in (("seeds", 1), ("runs", 1), ("draws", 1), ("steps", 0), ("scenes", 1)):
        value = getattr(arguments, name)
        if value is not None and value < least:
            parser.error(f"--{name}: expected at least {least}, got {value}")
    trained = [kind for kind in LEFT_OUT if kind in arguments.kinds]
    if len(trained) < 3:  # one is left out; folds need two scenes
        parser.error(f"--kinds: expected at least three that are trained on, got {', '.join(trained) or 'none'}")
    if "ycb" in arguments.kinds and "desk" not in trained:
        parser.error("--kinds: ycb is scored by the models without desks; add desk")
    for kind in set(REAL) & set(arguments.kinds):
        if not (arguments.data / kind).is_dir():
            parser.error(f"--data: expected a folder with {kind}/, got {arguments.data}")
    arguments.work.mkdir(parents=True, exist_ok=True)
    file, record = arguments.work / "arguments.json", {"kinds": str(sorted(arguments.kinds))}
    record |= {name: str(getattr(arguments, name)) for name in ("models", "scenes", "runs", "draws", "steps")}
    if file.is_file() and (before := json.loads(file.read_text())) != record:
        parser.error(f"work: {arguments.work} has results of other arguments: {before}; choose another folder")
    write_text(file, json.dumps(record))


def scenes(kind: str, purpose: str, arguments: argparse.Namespace) -> list[Named]:
    """The scenes of a kind of data for a purpose: training, tuning or scoring."""
    if kind in DOMAINS:
        seeds = {"training": TRAINING, "tuning": TUNING, "scoring": SCORING}[purpose]
        make = partial(make_scene, kind, models=arguments.models, held_out=purpose == "scoring")
        seeds = tuple(seeds)[: arguments.scenes]
        return [Named(f"{kind}-{seed}{'-held' * (purpose == 'scoring')}", partial(make, seed)) for seed in seeds]
    found = tj.datasets.list_scenes(arguments.data / kind)
    names = sorted(found, key=lambda name: (len(name), name))
    if kind == "ycb":
        chosen = [] if purpose == "training" else names
    else:
        chosen = {"training": names[0::2], "tuning": names[0::2][:6], "scoring": names[1::2]}[purpose]
    return [Named(f"{kind}-{name}", partial(load_thinned, found[name], kind)) for name in chosen[: arguments.scenes]]


def make_scene(domain: str, seed: int, models: Path | None, held_out: bool) -> Scene:
    return make_domain_scene(domain, seed, models=models, held_out=held_out).scene


def load_thinned(path: Path, kind: str) -> Scene:
    scene = tj.load_scene(path)
    return scene.select_points(voxel_subsample(scene.points, 0.005)) if kind == "mosd" else scene


def moved_scenes(named: Named, runs: int) -> list[Named]:
    """The scene to be scored, as each run sees it: its points are moved by noise of the run's own."""

    def load(run: int) -> Scene:
        scene = named.load()
        generator = torch.Generator().manual_seed(run)
        return replace(scene, points=moved(scene.points, NOISE, generator))

    return [Named(f"{named.name}.{run}", partial(load, run)) for run in range(runs)]


def to_score(kind: str, arguments: argparse.Namespace) -> list[Named]:
    """All runs of all scenes of a kind that are scored: the runs of the first scene, of the second, ..."""
    found = scenes(kind, "scoring", arguments)
    return [run for named in found for run in moved_scenes(named, arguments.runs)]


class Judged(NamedTuple):
    """A scene to be scored: its evidence with and without images, and the truth of its points."""

    with_images: LabelledEvidence
    without: LabelledEvidence
    of_point: Tensor
    truth: Tensor

    def scores(self, model: BoundaryModel, images: bool) -> tuple[float, float]:
        """F for objects and parts, and mean best IoU."""
        with one_thread_per_operation():
            labels = build_consensus((self.with_images if images else self.without).evidence, model).at()
        judged = score(labels[self.of_point], self.truth)
        return judged.f, judged.best_iou


def prepare(arguments: argparse.Namespace) -> None:
    """Collects the evidence of all scenes that is not in the folder yet."""
    folder: Path = arguments.work / "evidence"
    folder.mkdir(exist_ok=True)
    for kind in arguments.kinds:
        for name, load in scenes(kind, "training", arguments):
            if not (folder / f"{name}.pt").is_file():
                save_evidence(folder / f"{name}.pt", labelled_evidence(load()))
        for name, load in to_score(kind, arguments):
            path = folder / f"{name}-of-point.pt"
            if path.is_file():
                continue
            scene = load()
            save_evidence(folder / f"{name}.pt", labelled_evidence(scene))
            save_evidence(folder / f"{name}-without.pt", labelled_evidence(scene, images=False))
            segmenter = tj.JointSegmenter(learned_config())
            segmenter.reset(scene.points, scene.colors, scene.normals)
            assert scene.truth is not None
            torch.save((segmenter.graph.of_given, scene.truth.points), path)


def judged_scenes(kind: str, arguments: argparse.Namespace) -> list[Judged]:
    folder = arguments.work / "evidence"
    return [
        Judged(
            load_evidence(folder / f"{name}.pt"),
            load_evidence(folder / f"{name}-without.pt"),
            *torch.load(folder / f"{name}-of-point.pt"),
        )
        for name, _ in to_score(kind, arguments)
    ]


def score_left_out(work: Path, left_out: str, name: str, model: BoundaryModel, arguments: argparse.Namespace) -> None:
    """Scores a model that was trained without a kind of data on scenes of this kind."""
    for kind in [kind for kind in LEFT_OUT[left_out] if kind in arguments.kinds]:
        done = work / f"left-out-{kind}-{name}.json"
        if done.is_file():
            continue
        cases = judged_scenes(kind, arguments)
        rows = {
            row: [case.scores(model, images) for case in cases]
            for row, images in (("learned, left out", True), ("learned, left out, no images", False))
        }
        write_text(done, json.dumps(rows))
        print(kind, name, {row: np.mean(values, 0).round(3).tolist() for row, values in rows.items()}, flush=True)


def left_out_model(work: Path, left_out: str, seed: int, arguments: argparse.Namespace) -> BoundaryModel:
    """The model that never saw a kind of data; trained if it is not in the folder yet."""
    path = work / f"model-without-{left_out}-{seed}.npz"
    if path.is_file():
        return load_boundary_model(path)
    kinds = [kind for kind in LEFT_OUT if kind != left_out and kind in arguments.kinds]
    names = [named.name for kind in kinds for named in scenes(kind, "training", arguments)]
    examples = [training_evidence(work / "evidence" / f"{name}.pt") for name in names]
    model = fit_boundary_model(examples, replace(OPTIONS, seed=seed))
    save_boundary_model(path, model)
    return model


#: Most scenes serve all trainings but one.
training_evidence = lru_cache(maxsize=None)(load_evidence)


def score_default(work: Path, kind: str, arguments: argparse.Namespace) -> None:
    """Scores the package's default, with and without images. It saw other scenes of all kinds but the real desk."""
    done = work / f"default-{kind}.json"
    if done.is_file():
        return
    rows: dict[str, list[tuple[float, float]]] = {"default": [], "default, no images": []}
    for named in to_score(kind, arguments):
        scene = named.load()
        assert scene.truth is not None
        assert scene.truth.points is not None
        segmenter = tj.JointSegmenter(learned_config())
        for name, frames in zip(rows, (scene.frames, ()), strict=True):
            segmenter.reset(scene.points, scene.colors, scene.normals)
            for start in range(0, len(frames), FRAMES):
                segmenter.update([frames[i] for i in range(start, min(start + FRAMES, len(frames)))])
            judged = score(segmenter.compute(images=False).points, scene.truth.points)
            rows[name].append((judged.f, judged.best_iou))
    write_text(done, json.dumps(rows))
    print(kind, {name: np.mean(values, 0).round(3).tolist() for name, values in rows.items()}, flush=True)


def score_others(work: Path, kind: str, arguments: argparse.Namespace) -> None:
    """Scores the presets, and the common methods at the best settings for this kind of data."""
    done = work / f"others-{kind}.json"
    if done.is_file():
        return
    config = tj.Config()
    tuning = [Case(named.load(), config) for named in scenes(kind, "tuning", arguments)]
    budget = Budget(arguments.draws, arguments.steps)
    settings = {
        name: search(METHODS[name], kind, tuning, budget, work / f"search-{kind}-{name}.jsonl").setting
        for name in SIMPLE
    }
    rows: dict[str, list[tuple[float, float]]] = {}
    for named in to_score(kind, arguments):
        case = Case(named.load(), config)
        for name in (*(f"preset_{preset}" for preset in PRESETS), *SIMPLE):
            judged = run_scores(METHODS[name], settings.get(name, {}), case, False)["3D"]
            rows.setdefault(name, []).append((judged.f, judged.best_iou))
    write_text(done, json.dumps(rows))
    print(kind, {name: np.mean(values, 0).round(3).tolist() for name, values in rows.items()}, flush=True)


def score_final_images(work: Path, kind: str, arguments: argparse.Namespace) -> None:
    """Scores the default's final images, beside its initial images."""
    done = work / f"images-{kind}.json"
    if done.is_file():
        return
    rows: dict[str, list[tuple[float, float]]] = {"initial": [], "final": []}
    for named in to_score(kind, arguments):
        scene = named.load()
        result = tj.JointSegmenter()(scene)
        assert scene.truth is not None
        for name, images in zip(rows, (result.initial_images, result.images), strict=True):
            judged = score_images(images, scene.truth.images)
            if judged is not None:
                rows[name].append((judged.f, judged.best_iou))
    write_text(done, json.dumps(rows))
    print(kind, {name: np.mean(values, 0).round(3).tolist() for name, values in rows.items()}, flush=True)


if __name__ == "__main__":
    main()
