"""The scores of one segmentation: of point labels, or of a scene's label images."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import fmean
from typing import NamedTuple

from torch import Tensor

from torchjoint.metrics.objects_and_parts import objects_and_parts_of
from torchjoint.metrics.overlaps import best_iou_of, covering_of, overlap_tables
from torchjoint.runtime.threads import one_thread_per_operation, parallel_map


class Scores(NamedTuple):
    """Scores in [0, 1], higher is better; see :mod:`torchjoint.metrics`."""

    covering: float  #: symmetric segmentation covering
    precision: float  #: for objects and parts
    recall: float
    f: float
    best_iou: float  #: mean over the ground-truth instances


#: Titles of the columns in tables.
COLUMNS = ("covering", "precision", "recall", "F", "best IoU")


def score(pred: Tensor, target: Tensor) -> Scores:
    """Scores int64 labels of any shape; target -1 = void. Raises as the functions of :mod:`torchjoint.metrics`."""
    areas, tables = overlap_tables(pred, target)
    precision, recall, f = objects_and_parts_of(areas, tables)
    return Scores(covering_of(tables).symmetric, precision, recall, f, best_iou_of(tables))


def score_images(pred: Sequence[Tensor], target: Sequence[Tensor]) -> Scores | None:
    """Returns the mean over the images with ground truth; None if no image has any.

    Raises:
        ValueError: the number of images or the size of an image differs from the ground truth.
    """
    if len(pred) != len(target):
        raise ValueError(f"images: expected {len(target)}, one for each truth, got {len(pred)}")

    def score_one(index: int) -> Scores | None:
        image, truth = pred[index], target[index]
        if image.shape != truth.shape:
            raise ValueError(
                f"image {index}: expected the size of its truth, {list(truth.shape)}, got {list(image.shape)}"
            )
        return score(image, truth) if int(truth.max()) >= 0 else None

    with one_thread_per_operation():
        each = [scores for scores in parallel_map(score_one, range(len(target))) if scores is not None]
    return mean_scores(each) if each else None


def mean_scores(scores: Sequence[Scores]) -> Scores:
    """Returns the mean of each score over the samples of a data set; also F is averaged, not recomputed."""
    return Scores(*map(fmean, zip(*scores, strict=True)))
