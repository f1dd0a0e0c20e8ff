"""The search for a method's best setting: seeded draws at random, then steps from the best. It can be resumed."""

from __future__ import annotations

import json
import zlib
from collections.abc import Sequence
from pathlib import Path
from statistics import fmean
from typing import NamedTuple

import numpy as np
from tqdm import tqdm

from torchjoint.benchmark.case import Case
from torchjoint.benchmark.method import Method
from torchjoint.benchmark.space import Setting, draw, near
from torchjoint.evaluation.scores import Scores, score, score_images


class Trial(NamedTuple):
    """A setting that was tried: mean over the scenes of (F + best IoU) / 2."""

    setting: Setting
    score: float


class Budget(NamedTuple):
    """How many settings are tried."""

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
    """The best of `budget` settings on some scenes; ties: the first.

    Args:
        log: a line a trial, JSON. Trials that are there already are not run again, so that a search that was
            interrupted goes on where it was; the settings that are tried are always the same.
    """
    space = method.space_in(suite)
    random = np.random.default_rng([seed, zlib.crc32(f"{suite} {method.name}".encode())])
    known = _read(log)
    best: Trial | None = None
    bar = tqdm(range(sum(budget) if space else 1), desc=method.name, unit="setting", disable=not progress)
    for index in bar:
        setting = draw(space, random) if best is None or index < budget.draws else near(best.setting, space, random)
        if index < len(known) and known[index].setting == setting:
            trial = known[index]
        else:
            trial = Trial(setting, quality(method, setting, cases))
            known = [*known[:index], trial]
            _write(log, known)
        if best is None or trial.score > best.score:
            best = trial
            bar.set_postfix(best=f"{best.score:.3f}")
    assert best is not None
    return best


def quality(method: Method, setting: Setting, cases: Sequence[Case]) -> float:
    """What a search makes large: the mean over the scenes of (F + best IoU) / 2."""
    return fmean(_judged(run_scores(method, setting, case), method.judged) for case in cases)


def run_scores(method: Method, setting: Setting, case: Case, images: bool | None = None) -> dict[str, Scores]:
    """Scores by "3D" and "2D", as far as there are labels and truth.

    Args:
        images: whether images are wanted; default: only if the method is judged by them.
    """
    result = method.run(case, setting, method.judged == "2D" if images is None else images)
    truth = case.scene.truth
    if truth is None:
        raise ValueError(f"{case.scene.name}: the scene comes without truth")
    scores = {}
    if result.points is not None and truth.points is not None:
        scores["3D"] = score(result.points, truth.points)
    if len(result.images) and len(truth.images):
        in_2d = score_images(result.images, truth.images)
        scores |= {"2D": in_2d} if in_2d else {}
    return scores


def _judged(scores: dict[str, Scores], space: str) -> float:
    chosen = scores.get(space) or next(iter(scores.values()))
    return (chosen.f + chosen.best_iou) / 2


def _read(log: Path) -> list[Trial]:
    if not log.is_file():
        return []
    trials = []
    for number, line in enumerate(log.read_text(encoding="utf-8").splitlines(), start=1):
        try:
            values = json.loads(line)
            trials.append(Trial(dict(values["setting"]), float(values["score"])))
        except (ValueError, KeyError, TypeError) as error:
            raise ValueError(f"{log}, line {number}: not a trial of a search: {error!r}") from error
    return trials


def _write(log: Path, trials: Sequence[Trial]) -> None:
    partial = log.with_name(f".{log.name}.partial")
    partial.write_text("".join(json.dumps(trial._asdict()) + "\n" for trial in trials), encoding="utf-8")
    partial.replace(log)
