"""Tuning on one half of a suite, scoring on the other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from tqdm import tqdm

from torchjoint.benchmark.case import Case
from torchjoint.benchmark.method import Method
from torchjoint.benchmark.search import Budget, Trial, run_scores, search
from torchjoint.benchmark.space import Setting
from torchjoint.benchmark.suites import Suite, load_all
from torchjoint.evaluation.table import Row


def tune(suite: Suite, methods: Sequence[Method], data: Path | None, budget: Budget, folder: Path) -> dict[str, Trial]:
    """The best setting of each method on the tuning half; the trials are kept in `folder`, and not run twice."""
    scenes = suite.scenes("tuning", data)
    loaded = tqdm(load_all(scenes), total=len(scenes), desc="load", unit="scene")
    cases = [Case(scene, suite.config) for scene in loaded]
    found = {}
    for method in methods:
        if method.like is None:
            found[method.name] = search(
                method, suite.name, cases, budget, folder / f"{method.name}.jsonl", progress=True
            )
            for case in cases:
                case.forget()
    return found


def compare(
    suite: Suite, methods: Sequence[Method], settings: Mapping[str, Setting], data: Path | None, half: str = "checking"
) -> list[Row]:
    """The scores of each method on each scene of a half."""
    scenes = suite.scenes(half, data)
    rows = []
    for name, scene in zip(scenes, tqdm(load_all(scenes), total=len(scenes), unit="scene"), strict=True):
        case = Case(scene, suite.config)
        for method in methods:
            setting = settings.get(method.like or method.name, {})
            rows += [Row(name, method.name, *scores) for scores in run_scores(method, setting, case, True).items()]
    return rows
