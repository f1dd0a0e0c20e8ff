"""Tunes methods on the tuning scenes of a suite, and scores them on the checking scenes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from tqdm import tqdm

from torchjoint.scene import Scene
from torchjoint_lab.benchmark.case import Case
from torchjoint_lab.benchmark.method import Method, Result
from torchjoint_lab.benchmark.presets import preset_config
from torchjoint_lab.benchmark.search import Budget, Trial, score_result, search
from torchjoint_lab.benchmark.space import Setting
from torchjoint_lab.benchmark.suites import Suite, load_all
from torchjoint_lab.evaluation.kinds import best_iou_by_kind
from torchjoint_lab.evaluation.table import Row

#: Evenly spread frames of a scene on which image-only methods are tuned, and the largest number of tuning scenes
#: (all scenes are held in memory).
TUNING_FRAMES, MAX_TUNING_SCENES = 6, 12


def tune(suite: Suite, methods: Sequence[Method], data: Path | None, budget: Budget, folder: Path) -> dict[str, Trial]:
    """Returns the best trial of each method on the tuning scenes; logs trials in `folder`, so that none runs twice."""
    scenes = dict(list(suite.scenes("tuning", data).items())[:MAX_TUNING_SCENES])
    loaded = tqdm(load_all(scenes), total=len(scenes), desc="load", unit="scene")
    preset = preset_config(suite.preset)
    cases = [Case(scene, suite.config, preset) for scene in loaded]
    few = [Case(case.scene.sample_frames(TUNING_FRAMES), suite.config, preset) for case in cases]
    found = {}
    for method in methods:
        if method.space_in(suite.name):
            judged = few if method.judged == "2D" else cases
            log = folder / f"{method.name}.jsonl"
            found[method.name] = search(method, suite.name, judged, budget, log, progress=True)
            for case in judged:
                case.forget()
    return found


def compare(
    suite: Suite, methods: Sequence[Method], settings: Mapping[str, Setting], data: Path | None, half: str = "checking"
) -> Iterator[list[Row]]:
    """Yields the scores of all methods, scene by scene, for one half; no rows for a scene without ground truth."""
    scenes = suite.scenes(half, data)
    preset = preset_config(suite.preset)
    for name, scene in zip(scenes, tqdm(load_all(scenes), total=len(scenes), unit="scene"), strict=True):
        case = Case(scene, suite.config, preset)
        rows = []
        for method in methods:
            setting = settings.get(method.like or method.name, {})
            result = method.run(case, setting, True)
            for space, scores in score_result(result, scene).items():
                if method.like is None or space == "2D":  # the points are the same as those of method.like
                    rows.append(Row(name, method.name, space, scores, _by_kind(result, scene) if space == "3D" else {}))
        yield rows


def _by_kind(result: Result, scene: Scene) -> dict[str, float]:
    return best_iou_by_kind(result.points, scene.truth) if result.points is not None and scene.truth else {}
