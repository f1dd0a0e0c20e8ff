"""Tables that compare several methods over several scenes."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from statistics import fmean
from typing import NamedTuple

from torchjoint_lab.evaluation.scores import COLUMNS
from torchjoint_lab.evaluation.table import Row, markdown, standard_error, summarize


class Difference(NamedTuple):
    """The mean difference between two methods, paired by scene."""

    mean: float
    error: float  #: standard error of the mean of the paired differences


def paired_difference(rows: Sequence[Row], space: str, method: str, other: str) -> dict[str, Difference]:
    """Returns `method` minus `other`, by score, over the scenes of both; NaN without a common scene."""
    ours, theirs = ({r.scene: r.scores for r in rows if (r.method, r.space) == (m, space)} for m in (method, other))
    differences = {}
    for index, column in enumerate(COLUMNS):
        values = [ours[scene][index] - theirs[scene][index] for scene in ours if scene in theirs]
        differences[column] = Difference(fmean(values), standard_error(values)) if values else Difference(
            math.nan, math.nan
        )  # fmt: skip
    return differences


def summary_table(rows: Sequence[Row], space: str, titles: Callable[[str], str] = str) -> str:
    """Returns a table with one line per method: the means over all scenes."""
    kinds = sorted({kind for row in rows if row.space == space for kind in row.kinds})
    body = []
    for s in summarize(rows, space):
        by_kind = (f"{s.kinds[kind]:.3f}" if kind in s.kinds else "" for kind in kinds)
        body.append([titles(s.method), *(f"{value:.3f}" for value in s.mean), *by_kind])
    return markdown([space, *COLUMNS, *(f"{kind} IoU" for kind in kinds)], body)


def method_table(rows: Sequence[Row], space: str, titles: Callable[[str], str] = str) -> str:
    """Returns a table with one line per scene and one column per method: F / best IoU."""
    methods = [s.method for s in summarize(rows, space)]
    scores = {(row.scene, row.method): row.scores for row in rows if row.space == space}
    body = []
    for scene in dict.fromkeys(row.scene for row in rows if row.space == space):
        found = [scores.get((scene, method)) for method in methods]
        body.append([scene, *("" if one is None else f"{one.f:.3f} / {one.best_iou:.3f}" for one in found)])
    return markdown([f"{space}, F / best IoU", *map(titles, methods)], body)
