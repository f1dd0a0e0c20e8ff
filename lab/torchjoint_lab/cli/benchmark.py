"""torchjoint-lab benchmark: compares methods on labelled scenes."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from torchjoint.runtime.files import write_text
from torchjoint.runtime.messages import needed_for
from torchjoint.runtime.outputs import Output
from torchjoint_lab.benchmark.method import Method
from torchjoint_lab.benchmark.methods import METHODS
from torchjoint_lab.benchmark.run import compare, tune
from torchjoint_lab.benchmark.search import Budget
from torchjoint_lab.benchmark.settings import read_settings, write_settings
from torchjoint_lab.benchmark.space import Setting
from torchjoint_lab.benchmark.suites import SUITES, Suite
from torchjoint_lab.benchmark.tables import method_table, paired_difference, summary_table
from torchjoint_lab.cli.arguments import check_output
from torchjoint_lab.cli.benchmark_masks import benchmark_masks
from torchjoint_lab.evaluation.table import Row, summarize, write_csv, write_plot

TABLE, SCORES, PICTURE, SETTINGS = "table.md", "scores.csv", "scores.png", "settings.yaml"

SuiteName = Literal[
    "masks", "synthetic", "sparse", "mosd", "kitti", "scannet",
    "table", "shelf", "bin", "desk", "kitchen", "room", "workshop", "street",
]  # fmt: skip


def benchmark(
    suite: Annotated[SuiteName, tyro.conf.Positional],
    data: Path | None = None,
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None,
    methods: tuple[str, ...] = (),
    settings: Path | None = None,
    tuning: tuple[int, int] | None = None,
    half: Literal["checking", "tuning"] = "checking",
    page: Path | None = None,
    overwrite: bool = False,
    scenes: int | None = None,
    noise_seeds: int | None = None,
    domains: tuple[str, ...] = (),
) -> None:
    """Compares the joint method with its ablations and with common alternatives on labelled scenes.

    Each method uses one setting for all scenes.

    Args:
        suite: kind of scenes; the last eight are generated (`make_domain_scene`). "masks" compares ways of
            bringing a network's masks to 3D, on generated scenes (`torchjoint_lab.synthetic.with_network_masks`).
        data: folder of the data set; not needed for synthetic scenes.
        out: folder for table.md, scores.csv, scores.png, settings.yaml; default: benchmark-SUITE.
        methods: run only these methods; default: all.
        settings: YAML file with the methods' settings; default: the settings that come with the package.
        tuning: first run a hyperparameter search for each method on the tuning half of the suite: number of random
            draws, then number of steps from the best setting, for example 60 40. The search can be interrupted and
            resumed.
        half: half of the scenes that the table shows.
        page: Markdown file; its part between the marks `<!-- benchmark SUITE -->` and `<!-- end benchmark SUITE -->`
            is replaced by the table of all methods.
        overwrite: replace files in OUT.
        scenes: only masks: number of scenes of each domain; default: 4.
        noise_seeds: only masks: runs of each scene and level, with other masks and moved points; default: 4.
        domains: only masks: kinds of scenes; default: room table shelf.
    """
    if suite == "masks":
        sizes = {"scenes": scenes, "noise_seeds": noise_seeds, "domains": domains or None}
        given = {name: value for name, value in sizes.items() if value is not None} | {"overwrite": overwrite}
        _benchmark_masks(out, methods, half, page, given, (data, settings, tuning))
        return
    for name, value in (("--scenes", scenes), ("--noise-seeds", noise_seeds), ("--domains", domains or None)):
        if value is not None:
            raise ValueError(f"{name}: only suite masks has it, got suite {suite}")
    kind, chosen = SUITES[suite], _chosen(methods)
    out = out or Path(f"benchmark-{suite}")
    # Errors in the arguments, and missing packages, must be reported before hours of work.
    with needed_for("torchjoint-lab benchmark", "scikit-image and scikit-learn", "torchjoint-lab"):
        import skimage.segmentation  # noqa: F401
        import sklearn.cluster  # noqa: F401
    files = check_output(out, (TABLE, SCORES, PICTURE, SETTINGS), overwrite, (data, settings))
    _check_page(page, suite, len(chosen) == len(METHODS) and half == "checking")
    if tuning is not None and (tuning[0] < 1 or tuning[1] < 0):
        raise ValueError(f"--tuning: expected draws >= 1 and steps >= 0, got {tuning[0]} {tuning[1]}")
    if tuning is not None and kind.tuned_as:
        raise ValueError(f"--tuning: suite {suite} uses the settings of suite {kind.tuned_as}; tune that")
    kind.scenes(half, data)
    used = read_settings(kind.tuned_as or suite, settings)
    out.mkdir(parents=True, exist_ok=True)
    if tuning is not None:
        used |= _tuned(kind, chosen, data, Budget(*tuning), out)
    _tell_untuned(kind, chosen, used)
    rows: list[Row] = []
    for of_scene in compare(kind, chosen, used, data, half):
        rows += of_scene
        with files[SCORES].written() as path:
            write_csv(path, rows)
    if not rows:
        raise ValueError(f"--data: none of the {half} scenes has a truth to compare with")
    text = report(rows, kind, half)
    names = dict.fromkeys(method.like or method.name for method in chosen)
    with files[SETTINGS].written() as path:
        write_settings(path, {name: used[name] for name in names if name in used}, f"suite {suite}")
    _write_tables(files, rows, text)
    print(f"written to {out}: {TABLE}, {SCORES}, {PICTURE}, {SETTINGS}")
    if page is not None:
        _fill(page, f"benchmark {suite}", text)
        print(f"and to {page}")


def _write_tables(files: Mapping[str, Output], rows: list[Row], text: str) -> None:
    """Writes the picture, and the table of all scenes with one of each scene, which is printed too."""
    with files[PICTURE].written() as path:
        write_plot(path, rows, _title)
    by_scene = "\n\n".join(method_table(rows, space, _title) for space in dict.fromkeys(row.space for row in rows))
    with files[TABLE].written() as path:
        write_text(path, f"{text}\n\n{by_scene}\n")
    print(f"\n{by_scene}\n\n{text}\n")


def _benchmark_masks(
    out: Path | None,
    methods: tuple[str, ...],
    half: Literal["checking", "tuning"],
    page: Path | None,
    sizes: Mapping[str, Any],
    others: tuple[object, object, object],
) -> None:
    for name, value in zip(("--data", "--settings", "--tuning"), others, strict=True):
        if value is not None:
            raise ValueError(f"{name}: suite masks has none")
    _check_page(page, "masks", not methods and half == "checking")
    text = benchmark_masks(out or Path("benchmark-masks"), half, methods, **sizes)
    if page is not None:
        _fill(page, "benchmark masks", text)


def report(rows: Sequence[Row], suite: Suite, half: str) -> str:
    """Returns the tables, and the differences between joint and the other methods, paired by scene."""
    scenes = len({row.scene for row in rows})
    parts = [f"{scenes} {half} scenes: {suite.what}. Means over the scenes, each method at one setting."]
    for space in ("3D", "2D"):
        if any(row.space == space for row in rows):
            parts += [summary_table(rows, space, _title), *_compared(rows, space)]
    return "\n\n".join(parts)


def _compared(rows: Sequence[Row], space: str) -> list[str]:
    others = [s.method for s in summarize(rows, space) if s.method != "joint"]
    if not others or not any(row.method == "joint" for row in rows):
        return []
    lines = []
    for other in others:
        gain = paired_difference(rows, space, "joint", other)
        columns = ", ".join(f"{c} {gain[c].mean:+.3f} ± {gain[c].error:.3f}" for c in ("F", "best IoU"))
        lines.append(f"- {columns} over {_title(other)}")
    return ["joint (final), paired by scene, with the standard error of the difference:", "\n".join(lines)]


def _tuned(
    suite: Suite, methods: Sequence[Method], data: Path | None, budget: Budget, out: Path
) -> Mapping[str, Setting]:
    logs = out / "search"
    logs.mkdir(exist_ok=True)
    found = tune(suite, methods, data, budget, logs)
    for name, trial in found.items():
        print(f"{name}: (F + best IoU) / 2 = {trial.score:.3f} on the tuning half, at {trial.setting}")
    return {name: trial.setting for name, trial in found.items()}


def _chosen(names: Sequence[str]) -> list[Method]:
    unknown = [name for name in names if name not in METHODS]
    if unknown:
        raise ValueError(f"--methods: expected some of {', '.join(METHODS)}, got {unknown[0]!r}")
    return [method for name, method in METHODS.items() if not names or name in names]


def _title(name: str) -> str:
    return METHODS[name].title


def _tell_untuned(suite: Suite, methods: Sequence[Method], used: Mapping[str, Setting]) -> None:
    untuned = [
        method.title for method in methods if method.space_in(suite.tuned_as or suite.name) and method.name not in used
    ]
    if untuned:
        print(f"at their defaults, not tuned for {suite.name} (--tuning does that): {'; '.join(untuned)}")


def _check_page(page: Path | None, suite: str, is_whole: bool) -> None:
    if page is None:
        return
    if not page.is_file() or f"<!-- benchmark {suite} -->" not in page.read_text(encoding="utf-8"):
        raise ValueError(f"--page: {page} has no part <!-- benchmark {suite} --> ... <!-- end benchmark {suite} -->")
    if not is_whole:
        raise ValueError("--page: is for the table of all methods on the checking half")


def _fill(page: Path, part: str, text: str) -> None:
    """Replaces the text between a page's marks of this part."""
    pattern = re.compile(rf"(<!-- {part} -->\n).*?(<!-- end {part} -->)", flags=re.DOTALL)
    filled = pattern.sub(lambda m: f"{m[1]}{text}\n{m[2]}", page.read_text(encoding="utf-8"))
    write_text(page.resolve(), filled)  # a link stays one
