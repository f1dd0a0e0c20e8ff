"""The rows of the paper's tables: how well scenes are segmented in 3D (I) and in their images (II), and by rivals."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from statistics import fmean
from typing import NamedTuple

import torch
from torch import Tensor
from tqdm import tqdm

from torchjoint.evaluation.table import markdown
from torchjoint.metrics.covering import covering_of
from torchjoint.metrics.objects_and_parts import (
    average_precision_objects_of,
    average_precision_parts_of,
    objects_and_parts_of,
)
from torchjoint.metrics.overlaps import overlap_tables

#: Place of a frame, size (H, W) of its truth -> label image of that size.
LabelImages = Callable[[int, tuple[int, int]], Tensor]


class Scores(NamedTuple):
    """The columns of both tables; all in [0, 1]."""

    precision: float  #: for objects and parts
    recall: float
    f: float
    covering: float  #: symmetric: the mean of the two that follow
    target_by_pred: float
    pred_by_target: float
    ap_objects: float
    ap_parts: float


#: What the columns are called.
COLUMNS = ("precision", "recall", "F", "covering", "truth by segments", "segments by truth", "AP_o", "AP_p")


class Row(NamedTuple):
    """What a row is about."""

    table: str  #: I (points) or II (pixels)
    method: str
    on: str  #: P, all points; P_D, those that 3D-SIS detected; images


#: All rows, in the order of the tables.
ROWS = (
    Row("I", "3D-SIS", "P"),
    Row("I", "ours", "P"),
    Row("I", "3D-SIS", "P_D"),
    Row("I", "ours", "P_D"),
    Row("II", "initial", "images"),
    Row("II", "final", "images"),
    Row("II", "SceneCut", "images"),
)


def score(pred: Tensor, target: Tensor) -> Scores:
    """One segmentation against the truth, -1 = void; see :mod:`torchjoint.metrics`."""
    areas, tables = overlap_tables(pred, target)
    covering = covering_of(tables)
    return Scores(
        *objects_and_parts_of(areas, tables),
        covering.symmetric,
        covering.target_by_pred,
        covering.pred_by_target,
        average_precision_objects_of(areas, tables),
        average_precision_parts_of(areas, tables),
    )


def mean_scores(scores: Iterable[Scores]) -> Scores:
    """The mean of each column."""
    return Scores(*map(fmean, zip(*scores, strict=True)))


def score_points(ours: Tensor, truth: Tensor, detected: Tensor | None) -> dict[Row, Scores]:
    """The rows of table I for one scene.

    Args:
        ours: [N] labels.
        truth: [N] instances, -1 = void.
        detected: [N] labels by 3D-SIS, -1 = nothing detected; None: there are none.

    Returns:
        No rows where nothing has a truth, and those on P_D only where 3D-SIS detected something that has.

    Raises:
        ValueError: shapes that differ.
    """
    methods = {"ours": ours} if detected is None else {"3D-SIS": detected, "ours": ours}
    targets = {"P": truth}
    if detected is not None:
        targets["P_D"] = torch.where(detected >= 0, truth, -1)
    return {
        Row("I", method, on): score(labels, target)
        for on, target in targets.items()
        if bool((target >= 0).any())
        for method, labels in methods.items()
    }


def score_images(
    methods: Mapping[str, LabelImages], truth: Sequence[Tensor], *, progress: bool = False
) -> dict[Row, Scores]:
    """The rows of table II for one scene, means over the images that have a truth.

    Args:
        methods: what each of them makes of an image.
        truth: label images, -1 = void.
        progress: show a progress bar.

    Raises:
        ValueError: sizes that differ.
    """
    found = defaultdict(list)
    for i in tqdm(range(len(truth)), desc="score", unit="image", disable=not progress):
        target = truth[i]
        if int(target.max()) < 0:
            continue
        for method, labels in methods.items():
            found[Row("II", method, "images")].append(score(labels(i, (target.shape[0], target.shape[1])), target))
    return {row: mean_scores(scores) for row, scores in found.items()}


def comparable(found: Mapping[str, Mapping[Row, Scores]]) -> dict[Row, list[Scores]]:
    """The scores of each row, of the scenes that have all rows on the same data: means of other scenes do not compare.

    Args:
        found: by scene, the rows it has. A method that has no scene at all does not count; where no scene has all rows,
            each row keeps those that it has.
    """
    rows: dict[Row, list[Scores]] = {}
    there = [row for row in ROWS if any(row in scores for scores in found.values())]
    for row in there:
        beside = [other for other in there if (other.table, other.on) == (row.table, row.on)]
        whole = [scores for scores in found.values() if all(other in scores for other in beside)]
        rows[row] = [scores[row] for scores in whole or found.values() if row in scores]
    return rows


def paper_table(rows: Mapping[Row, Sequence[Scores]], table: str) -> str:
    """One of the tables as Markdown: of each row how many scenes it has, and their mean; empty if it has none."""
    body = [
        [f"{row.method}, {row.on}", str(len(rows[row])), *(f"{value:.3f}" for value in mean_scores(rows[row]))]
        for row in ROWS
        if row.table == table and row in rows
    ]
    return markdown([f"table {table}", "scenes", *COLUMNS], body) if body else ""
