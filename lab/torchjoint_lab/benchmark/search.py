"""Hyperparameter search: seeded random draws, then steps from the best setting. A search can be resumed."""

from __future__ import annotations

import hashlib
import json
import zlib
from collections.abc import Sequence
from pathlib import Path
from statistics import fmean
from typing import NamedTuple

import numpy as np
from tqdm import tqdm

from torchjoint.runtime.files import write_text
from torchjoint.scene import Scene, Truth
from torchjoint_lab.benchmark.case import Case
from torchjoint_lab.benchmark.method import Method, Result
from torchjoint_lab.benchmark.space import Setting, draw, near
from torchjoint_lab.evaluation.partial_truth import knows_points
from torchjoint_lab.evaluation.scores import Scores, score, score_images


class Trial(NamedTuple):
    """A setting and its score: the mean over the scenes of (F + best IoU) / 2."""

    setting: Setting
    score: float


class Budget(NamedTuple):
    """How many settings are tried: random draws, then steps from the best setting."""

    draws: int = 60
    steps: int = 40


def search(
    method: Method,
    suite: str,
    cases: Sequence[Case],
    budget: Budget,
    log: Path,
    *,
    seed: int = 0,
    progress: bool = False,
) -> Trial:
    """Finds the best of `budget` settings on some scenes; of equal scores the first wins.

    Args:
        method: the method to tune.
        suite: name of the suite; chooses the parameter ranges.
        cases: scenes; scenes without ground truth are ignored.
        budget: how many settings are tried.
        log: JSON lines: a hash that identifies the search, then one line per trial. Logged trials are not run again, so
            an interrupted search continues. The sequence of settings is deterministic.
        seed: of the random settings.
        progress: show a progress bar.

    Raises:
        ValueError: the log belongs to a search on other scenes or in other ranges; no scene has ground truth; the
            budget is empty.
    """
    cases = [case for case in cases if _has_truth(case)]
    if not cases or budget.draws < 1 or budget.steps < 0:
        raise ValueError(
            f"search: expected scenes with truth, draws >= 1, steps >= 0, got {len(cases)} scenes, {budget}"
        )
    space = method.space_in(suite)
    key = _key(method, suite, cases, seed)
    random = np.random.default_rng([seed, zlib.crc32(f"{suite} {method.name}".encode())])
    known = _read(log, key)
    best: Trial | None = None
    bar = tqdm(range(sum(budget) if space else 1), desc=method.name, unit="setting", disable=not progress)
    for index in bar:
        setting = draw(space, random) if best is None or index < budget.draws else near(best.setting, space, random)
        if index < len(known) and known[index].setting == setting:
            trial = known[index]
        else:
            trial = Trial(setting, quality(method, setting, cases))
            known = [*known[:index], trial]
            _write(log, key, known)
        if best is None or trial.score > best.score:
            best = trial
            bar.set_postfix(best=f"{best.score:.3f}")
    assert best is not None
    return best


def quality(method: Method, setting: Setting, cases: Sequence[Case]) -> float:
    """Returns the objective of the search: the mean over the scenes of (F + best IoU) / 2."""
    return fmean(_judged(run_scores(method, setting, case), method.judged) for case in cases)


def run_scores(method: Method, setting: Setting, case: Case, images: bool | None = None) -> dict[str, Scores]:
    """Runs a method; returns its scores by "3D" and "2D", where there are both labels and ground truth.

    Args:
        images: whether image labels are wanted; default: only if the method is judged by its image labels.
    """
    return score_result(method.run(case, setting, method.judged == "2D" if images is None else images), case.scene)


def score_result(result: Result, scene: Scene) -> dict[str, Scores]:
    """Returns scores by "3D" and "2D", where there are both labels and ground truth."""
    truth = scene.truth or Truth()
    scores = {}
    if result.points is not None and truth.points is not None and knows_points(truth):
        scores["3D"] = score(result.points, truth.points)
    if len(result.images) and len(truth.images):
        in_2d = score_images(result.images, truth.images)
        scores |= {"2D": in_2d} if in_2d else {}
    return scores


def _judged(scores: dict[str, Scores], space: str) -> float:
    chosen = scores.get(space) or next(iter(scores.values()))
    return (chosen.f + chosen.best_iou) / 2


def _has_truth(case: Case) -> bool:
    truth = case.scene.truth or Truth()
    return knows_points(truth) or any(int(image.max()) >= 0 for image in truth.images)


def _key(method: Method, suite: str, cases: Sequence[Case], seed: int) -> str:
    """Hash that identifies a search: its method, ranges, scenes and seed."""
    parts = [method.name, suite, str(seed), str(method.space_in(suite))]
    parts += [f"{case.digest()} {len(case.frames)} {case.config} {case.preset}" for case in cases]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()


def _read(log: Path, key: str) -> list[Trial]:
    if not log.is_file():
        return []
    first, *lines = log.read_text(encoding="utf-8").splitlines() or [""]
    if first != json.dumps({"search": key}):
        raise ValueError(f"{log}: is of a search on other scenes or in other ranges; remove it, or choose another -o")
    trials = []
    for number, line in enumerate(lines, start=2):
        try:
            values = json.loads(line)
            trials.append(Trial(dict(values["setting"]), float(values["score"])))
        except (ValueError, KeyError, TypeError) as error:
            raise ValueError(f"{log}, line {number}: not a trial of a search: {error!r}") from error
    return trials


def _write(log: Path, key: str, trials: Sequence[Trial]) -> None:
    write_text(log, "".join(json.dumps(line) + "\n" for line in ({"search": key}, *(t._asdict() for t in trials))))
