"""Tables of scores of several methods on several scenes: as text, CSV and picture."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from statistics import fmean, stdev
from typing import NamedTuple

from torchjoint.runtime.files import atomic_write, write_text
from torchjoint.runtime.foreign_files import csv_text
from torchjoint_lab.evaluation.scores import COLUMNS, Scores, mean_scores


class Row(NamedTuple):
    """Scores of one method on one scene, in 3D or in 2D."""

    scene: str
    method: str
    space: str  #: "3D" or "2D"
    scores: Scores
    kinds: Mapping[str, float] = {}  #: mean best IoU by kind of instance, if the ground truth has kinds


class Summary(NamedTuple):
    """Mean scores of one method over all scenes."""

    method: str
    num_scenes: int
    mean: Scores
    error: Scores  #: standard error of the mean over scenes; NaN for a single scene
    kinds: Mapping[str, float]  #: means over the scenes that contain the kind


def summarize(rows: Sequence[Row], space: str) -> list[Summary]:
    """Returns means over the scenes, by method in order of first appearance."""
    summaries = []
    for method in dict.fromkeys(row.method for row in rows if row.space == space):
        of_method = [row for row in rows if (row.method, row.space) == (method, space)]
        scores = [row.scores for row in of_method]
        error = Scores(*(standard_error(values) for values in zip(*scores, strict=True)))
        kinds = {kind: fmean(row.kinds[kind] for row in of_method if kind in row.kinds) for kind in _kinds(of_method)}
        summaries.append(Summary(method, len(scores), mean_scores(scores), error, kinds))
    return summaries


def _kinds(rows: Sequence[Row]) -> list[str]:
    return sorted({kind for row in rows for kind in row.kinds})


def standard_error(values: Sequence[float]) -> float:
    """Returns the standard error of the mean of the values; NaN for a single value."""
    return stdev(values) / math.sqrt(len(values)) if len(values) > 1 else math.nan


def markdown(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Returns a Markdown table that is also readable on a terminal, with numbers aligned to the right."""
    widths = [max(3, *(len(cell) for cell in column)) for column in zip(columns, *rows, strict=True)]
    aligned = [[cell.ljust(w) if i == 0 else cell.rjust(w) for i, (cell, w) in enumerate(zip(row, widths, strict=True))]
               for row in (columns, *rows)]  # fmt: skip
    rule = ["-" * widths[0], *("-" * (width - 1) + ":" for width in widths[1:])]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (aligned[0], rule, *aligned[1:]))


def scene_table(rows: Sequence[Row], titles: Callable[[str], str] = str) -> str:
    """Returns a table with one line per scene, method and space, then the means if there are several scenes."""
    several = len({row.method for row in rows}) > 1
    body = [[r.scene, *([titles(r.method)] if several else []), r.space, *(f"{v:.3f}" for v in r.scores)] for r in rows]
    for space in dict.fromkeys(row.space for row in rows) if len({row.scene for row in rows}) > 1 else ():
        for s in summarize(rows, space):
            body.append(["mean", *([titles(s.method)] if several else []), space, *(f"{v:.3f}" for v in s.mean)])
    return markdown(["scene", *(["method"] if several else []), "space", *COLUMNS], body)


def write_csv(path: Path, rows: Sequence[Row]) -> None:
    """Writes one line per scene, method and space; atomic (a temporary file is renamed)."""
    kinds = _kinds(rows)
    names = [*(name.replace(" ", "_") for name in Scores._fields), *(f"{kind}_iou" for kind in kinds)]
    lines: list[Sequence[object]] = [["scene", "method", "space", *names]]
    for row in rows:
        by_kind = (f"{row.kinds[kind]:.6f}" if kind in row.kinds else "" for kind in kinds)
        lines.append([row.scene, row.method, row.space, *(f"{value:.6f}" for value in row.scores), *by_kind])
    write_text(path, csv_text(lines))


def write_plot(path: Path, rows: Sequence[Row], titles: Callable[[str], str] = str) -> None:
    """Draws F and best IoU: for several methods their means and standard errors, for one method its scenes.

    Writes atomically (a temporary file is renamed).
    """
    from matplotlib.figure import Figure

    spaces = list(dict.fromkeys(row.space for row in rows))
    bars = [_bars(rows, space, titles) for space in spaces]
    figure = Figure(figsize=(6.2 * len(spaces), 1.2 + 0.5 * max(map(len, bars))), layout="constrained")
    for axis, space, of_space in zip(figure.subplots(1, len(spaces), squeeze=False)[0], spaces, bars, strict=True):
        for offset, (column, index) in enumerate((("F", 3), ("best IoU", 4))):
            places = [place + 0.38 * offset for place in range(len(of_space))]
            errors = [0.0 if math.isnan(error[index]) else error[index] for _, _, error in of_space]
            axis.barh(places, [mean[index] for _, mean, _ in of_space], 0.36, xerr=errors, label=column)
        axis.set_yticks([place + 0.19 for place in range(len(of_space))], [name for name, _, _ in of_space])
        axis.set(xlim=(0, 1), title=space)
        axis.invert_yaxis()
        axis.legend(loc="lower right")
    with atomic_write(path) as partial:
        figure.savefig(partial, dpi=100)


def _bars(rows: Sequence[Row], space: str, titles: Callable[[str], str]) -> list[tuple[str, Scores, Scores]]:
    if len({row.method for row in rows}) > 1:
        return [(titles(s.method), s.mean, s.error) for s in summarize(rows, space)]
    nothing = Scores(*[math.nan] * len(COLUMNS))
    return [(row.scene, row.scores, nothing) for row in rows if row.space == space]
