"""The rows of the paper's tables: scores of our method and the baselines in 3D (table I) and in images (table II)."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from statistics import fmean
from typing import NamedTuple

import torch
from torch import Tensor
from tqdm import tqdm

from torchjoint.metrics.objects_and_parts import (
    average_precision_objects_of,
    average_precision_parts_of,
    objects_and_parts_of,
)
from torchjoint.metrics.overlaps import covering_of, overlap_tables
from torchjoint_lab.evaluation.table import markdown

#: From the index of a frame and the size (H, W) of its ground truth to a label image of this size.
LabelImages = Callable[[int, tuple[int, int]], Tensor]


class Scores(NamedTuple):
    """The columns of both tables; all in [0, 1]."""

    precision: float  #: for objects and parts
    recall: float
    f: float
    covering: float  #: symmetric: the mean of the next two columns
    target_by_pred: float
    pred_by_target: float
    ap_objects: float
    ap_parts: float


#: Titles of the columns.
COLUMNS = ("precision", "recall", "F", "covering", "truth by segments", "segments by truth", "AP_o", "AP_p")


class Row(NamedTuple):
    """Table, method and data of a row."""

    table: str  #: I (points) or II (pixels)
    method: str
    on: str  #: P: all points; P_D: the points that 3D-SIS detected; images


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
    """Scores one segmentation against the ground truth, -1 = void; see :mod:`torchjoint.metrics`."""
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
    """Returns the mean of each column."""
    return Scores(*map(fmean, zip(*scores, strict=True)))


def score_points(ours: Tensor, truth: Tensor, detected: Tensor | None) -> dict[Row, Scores]:
    """Returns the rows of table I for one scene.

    Args:
        ours: [N] labels.
        truth: [N] ground-truth instances, -1 = void.
        detected: [N] labels of 3D-SIS, -1 = nothing detected; None: no result of 3D-SIS.

    Returns:
        No rows if all points are void; rows on P_D only if 3D-SIS detected a point that is not void.

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
    """Returns the rows of table II for one scene: means over the images with ground truth.

    Args:
        methods: by name, a function that returns the method's labels of an image.
        truth: ground-truth label images, -1 = void.
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
    """Returns the scores of each row, over the scenes that have all rows on the same data, so that means compare.

    Args:
        found: by scene, the rows of the scene. A method without any scene is ignored; if no scene has all rows, each
            row keeps all its scenes.
    """
    rows: dict[Row, list[Scores]] = {}
    there = [row for row in ROWS if any(row in scores for scores in found.values())]
    for row in there:
        beside = [other for other in there if (other.table, other.on) == (row.table, row.on)]
        whole = [scores for scores in found.values() if all(other in scores for other in beside)]
        rows[row] = [scores[row] for scores in whole or found.values() if row in scores]
    return rows


def paper_table(rows: Mapping[Row, Sequence[Scores]], table: str) -> str:
    """Returns a table as Markdown: for each row the number of scenes and the mean; empty if there are no rows."""
    body = [
        [f"{row.method}, {row.on}", str(len(rows[row])), *(f"{value:.3f}" for value in mean_scores(rows[row]))]
        for row in ROWS
        if row.table == table and row in rows
    ]
    return markdown([f"table {table}", "scenes", *COLUMNS], body) if body else ""
