"""Tuning on one half of a suite, scoring on the other."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from tqdm import tqdm

from torchjoint.benchmark.case import Case
from torchjoint.benchmark.method import Method, Result
from torchjoint.benchmark.search import Budget, Trial, score_result, search
from torchjoint.benchmark.space import Setting
from torchjoint.benchmark.suites import Suite, load_all
from torchjoint.config import Config
from torchjoint.evaluation.kinds import best_iou_by_kind
from torchjoint.evaluation.table import Row
from torchjoint.scene import Scene

#: Frames of a scene that methods of images alone are tuned on, evenly spread; and scenes that are tuned on at the most,
#: since all are held in memory.
JUDGED_FRAMES, MOST_SCENES = 6, 12


def tune(suite: Suite, methods: Sequence[Method], data: Path | None, budget: Budget, folder: Path) -> dict[str, Trial]:
    """The best setting of each method on the tuning half; the trials are kept in `folder`, and not run twice."""
    scenes = dict(list(suite.scenes("tuning", data).items())[:MOST_SCENES])
    loaded = tqdm(load_all(scenes), total=len(scenes), desc="load", unit="scene")
    preset = Config.from_preset(suite.preset)
    cases = [Case(scene, suite.config, preset) for scene in loaded]
    few = [Case(case.scene.spread_frames(JUDGED_FRAMES), suite.config, preset) for case in cases]
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
    """The scores of each method, scene by scene of a half; none of a scene without truth."""
    scenes = suite.scenes(half, data)
    preset = Config.from_preset(suite.preset)
    for name, scene in zip(scenes, tqdm(load_all(scenes), total=len(scenes), unit="scene"), strict=True):
        case = Case(scene, suite.config, preset)
        rows = []
        for method in methods:
            setting = settings.get(method.like or method.name, {})
            result = method.run(case, setting, True)
            for space, scores in score_result(result, scene).items():
                if method.like is None or space == "2D":  # its points are those of the other
                    rows.append(Row(name, method.name, space, scores, _by_kind(result, scene) if space == "3D" else {}))
        yield rows


def _by_kind(result: Result, scene: Scene) -> dict[str, float]:
    return best_iou_by_kind(result.points, scene.truth) if result.points is not None and scene.truth else {}
