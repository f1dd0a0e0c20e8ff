"""Scores a boundary detector: precision and recall against the boundaries of several annotators.

The protocol is the one of BSDS: D. R. Martin, C. C. Fowlkes and J. Malik, "Learning to Detect Natural Image Boundaries
Using Local Brightness, Color, and Texture Cues" (PAMI 2004), and P. Arbelaez et al., "Contour Detection and
Hierarchical Image Segmentation" (PAMI 2011). At each threshold the prediction is thinned to lines. Its pixels are
matched to each annotator's pixels, one to one, within a share of the image's diagonal. A predicted pixel is correct if
it is matched to a pixel of any annotator; recall counts the pixels of all annotators.

One thing is simpler here: a match has no cost. The largest number of pairs is chosen; their distances do not matter.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import torch
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import maximum_flow
from scipy.spatial import cKDTree
from torch import Tensor, nn
from tqdm import tqdm

from torchjoint.images.contours import suppress_non_maxima
from torchjoint.runtime.threads import one_thread_per_operation, parallel_map
from torchjoint_lab.datasets.bsds import BsdsImage
from torchjoint_lab.evaluation.skeleton import thin

#: Largest distance of a match, as a share of the image's diagonal.
TOLERANCE = 0.0075


class BoundaryCounts(NamedTuple):
    """Pixel counts of one image, or sums over several images, at each of T thresholds: [T] int64 each."""

    pred: Tensor  #: predicted pixels, after thinning
    pred_matched: Tensor  #: predicted pixels that are matched to any annotator's pixel
    target: Tensor  #: pixels of all annotators
    target_matched: Tensor  #: annotators' pixels that are matched to predicted pixels


class BoundaryCurve(NamedTuple):
    """Curve of a whole data set, at each of T thresholds: [T] float64 each. A division by zero gives 0."""

    threshold: Tensor
    precision: Tensor
    recall: Tensor
    f: Tensor


class BoundaryScores(NamedTuple):
    """Scores of a data set, all in [0, 1]."""

    ods: float  #: the best F with one threshold for all images
    ods_threshold: float  #: the threshold of the best F; of equals the lowest
    ods_precision: float
    ods_recall: float
    ois: float  #: F with the best threshold of each image; counts are summed before F is computed
    ap: float  #: average precision, see :func:`boundary_scores`
    curve: BoundaryCurve


def even_thresholds(count: int) -> Tensor:
    """Returns [count] float64, evenly spread inside (0, 1): 99 thresholds are 0.01, 0.02, ... 0.99."""
    if isinstance(count, bool) or not isinstance(count, int) or count < 1:
        raise ValueError(f"thresholds: expected a whole number >= 1, got {count!r}")
    return torch.arange(1, count + 1, dtype=torch.float64) / (count + 1)


@one_thread_per_operation()
def boundary_counts(
    pred: Tensor,
    boundaries: Sequence[Tensor],
    thresholds: Tensor,
    *,
    nms: bool = True,
    tolerance: float = TOLERANCE,
) -> BoundaryCounts:
    """Compares one image's prediction with all annotators' boundaries.

    Args:
        pred: [H, W] floating, boundary strength in [0, 1].
        boundaries: per annotator [H, W] bool, lines one pixel wide.
        thresholds: [T], in (0, 1]; a pixel is predicted where its strength is at least the threshold.
        nms: first apply non-maximum suppression; without it, thick predictions are thinned to their middle lines.
        tolerance: largest distance of a match, as a share of the image's diagonal.

    Raises:
        TypeError: tensors of other dtypes.
        ValueError: shapes that differ, strengths outside [0, 1] or NaN, no annotator, thresholds outside (0, 1].
    """
    _check_prediction(pred)
    _check_boundaries(boundaries, pred)
    if thresholds.ndim != 1 or not ((thresholds > 0) & (thresholds <= 1)).all():
        raise ValueError("thresholds: expected numbers in (0, 1], of shape [T]")
    strength = suppress_non_maxima(pred.detach().float()) if nms else pred.detach().float()
    radius = tolerance * math.hypot(*pred.shape)
    target = sum(int(one.sum()) for one in boundaries)
    rows: list[tuple[int, int, int, int]] = []
    last_area = -1
    for threshold in thresholds.tolist():
        mask = strength >= threshold
        area = int(mask.sum())
        if area != last_area or not rows:  # masks are nested: a mask of equal area is equal
            lines = thin(mask) if area else mask
            any_matched = torch.zeros_like(mask)
            target_matched = 0
            for boundary in boundaries:
                matched, found = matched_pixels(lines, boundary, radius)
                any_matched |= matched
                target_matched += int(found.sum())
            row = (int(lines.sum()), int(any_matched.sum()), target, target_matched)
        rows.append(row)
        last_area = area
    return BoundaryCounts(*torch.tensor(rows, dtype=torch.int64).reshape(-1, 4).unbind(1))


def matched_pixels(pred: Tensor, target: Tensor, radius: float) -> tuple[Tensor, Tensor]:
    """Pairs set pixels of two maps [H, W] bool within a radius, pixels; the number of pairs is the largest possible.

    Returns:
        the pixels of each map that have a partner, [H, W] bool.
    """
    own, other = pred.nonzero(), target.nonzero()
    found = torch.zeros_like(pred), torch.zeros_like(target)
    if len(own) and len(other):
        trees = [cKDTree(places.double().numpy()) for places in (own, other)]
        near = trees[0].sparse_distance_matrix(trees[1], radius, output_type="coo_matrix")
        # As a flow: scipy's maximum_bipartite_matching takes half a minute for some pairs of lines, this 10 ms.
        (rows, columns), source = near.shape, sum(near.shape)
        starts = np.concatenate([np.full(rows, source), near.row, np.arange(rows, source)])
        ends = np.concatenate([np.arange(rows), near.col + rows, np.full(columns, source + 1)])
        graph = csr_matrix((np.ones(len(starts), np.int32), (starts, ends)), shape=(source + 2, source + 2))
        flow = maximum_flow(graph, source, source + 1).flow[:rows, rows:source].tocoo()
        found[0][own[flow.row[flow.data > 0]].unbind(1)] = True
        found[1][other[flow.col[flow.data > 0]].unbind(1)] = True
    return found


def boundary_scores(counts: Sequence[BoundaryCounts], thresholds: Tensor) -> BoundaryScores:
    """Computes the scores of a data set from the counts of its images.

    AP is the area under the precision-recall curve: precision is interpolated linearly between the thresholds' points
    at the recalls 0.01, 0.02, ... 1.00 and averaged; it is 0 where the curve does not reach. So a prediction with only
    one strength has nearly no area, however good it is. A threshold without predicted pixels has precision and recall
    0. Of several points with the same recall, the most precise one counts.

    ODS is the best F of the given thresholds; there is no interpolation between them.

    Args:
        counts: of each image, at the same T thresholds.
        thresholds: [T], ascending.

    Raises:
        ValueError: no image, or counts at another number of thresholds.
    """
    if not counts:
        raise ValueError("counts: expected those of at least one image, got none")
    if any(len(column) != len(thresholds) for image in counts for column in image):
        raise ValueError(f"counts: expected tensors of shape [T] = [{len(thresholds)}]")
    by_image = torch.stack([torch.stack(list(image)) for image in counts])  # [I, 4, T]
    precision, recall, f = _rates(by_image.sum(0))
    best = int(f.argmax())
    own_best = _rates(by_image.transpose(0, 1))[2].argmax(1)  # [I]
    own = by_image[torch.arange(len(counts)), :, own_best].sum(0)
    return BoundaryScores(
        ods=float(f[best]),
        ods_threshold=float(thresholds[best]),
        ods_precision=float(precision[best]),
        ods_recall=float(recall[best]),
        ois=float(_rates(own)[2]),
        ap=_average_precision(precision, recall),
        curve=BoundaryCurve(thresholds.to(torch.float64), precision, recall, f),
    )


def evaluate_boundaries(
    detector: nn.Module,
    records: Sequence[BsdsImage],
    thresholds: int = 99,
    *,
    nms: bool = True,
    progress: bool = False,
) -> BoundaryScores:
    """Scores a boundary detector on images of BSDS500.

    Args:
        detector: a module [B, 3, H, W] -> [B, H, W], as in :mod:`torchjoint.images.boundary`.
        records: see :func:`torchjoint_lab.datasets.bsds.bsds_images`.
        thresholds: number of thresholds, evenly spread in (0, 1). The protocol has 99; 9 suffice to compare trainings.
        nms: apply non-maximum suppression to the detector's output before scoring.
        progress: show a progress bar.

    Raises:
        FileNotFoundError, ValueError: the message names the file, or the image with an invalid boundary strength.
    """
    return evaluate_predictions(
        lambda record: detector(record.image[None])[0], records, thresholds, nms=nms, progress=progress
    )


def evaluate_predictions(
    predict: Callable[[BsdsImage], Tensor],
    records: Sequence[BsdsImage],
    thresholds: int = 99,
    *,
    nms: bool = True,
    progress: bool = False,
) -> BoundaryScores:
    """As :func:`evaluate_boundaries`, for any function that returns a boundary strength [H, W] for a record."""
    chosen = even_thresholds(thresholds)
    with tqdm(total=len(records), desc="scoring boundaries", unit="image", disable=not progress) as bar:

        def count(record: BsdsImage) -> BoundaryCounts:
            boundaries = record.boundaries
            pred = predict(record)
            try:
                counts = boundary_counts(pred, boundaries, chosen, nms=nms)
            except (TypeError, ValueError) as error:
                raise type(error)(f"image {record.name}: {error}") from error
            bar.update()
            return counts

        with torch.no_grad():
            counts = parallel_map(count, records)
    return boundary_scores(counts, chosen)


def _rates(counts: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Counts [4, ...] to precision, recall, F: [...] float64 each."""
    pred, pred_matched, target, target_matched = counts.double().unbind(0)
    precision = pred_matched / pred.clamp(min=1)
    recall = target_matched / target.clamp(min=1)
    f = 2 * precision * recall / (precision + recall).clamp(min=1e-300)
    return precision, recall, f


def _average_precision(precision: Tensor, recall: Tensor) -> float:
    # Sorted by recall, then precision: of points with the same recall, the last one stays, which is the most precise.
    points = list(dict(sorted(zip(recall.tolist(), precision.tolist(), strict=True))).items())
    return sum(_interpolated(points, i / 100) for i in range(1, 101)) / 100


def _interpolated(points: list[tuple[float, float]], r: float) -> float:
    """Value at r of the polyline through (recall, precision), sorted by recall; 0 outside."""
    for (r0, p0), (r1, p1) in zip(points, points[1:] or points, strict=False):
        if r0 <= r <= r1:
            return p0 + (p1 - p0) * (r - r0) / (r1 - r0) if r1 > r0 else p0
    return 0.0


def _check_prediction(pred: Tensor) -> None:
    if not isinstance(pred, Tensor) or not pred.is_floating_point():
        got = pred.dtype if isinstance(pred, Tensor) else type(pred).__name__
        raise TypeError(f"pred: expected a floating tensor, got {got}")
    if pred.ndim != 2:
        raise ValueError(f"pred: expected shape [H, W], got {list(pred.shape)}")
    wrong = pred[~((pred >= 0) & (pred <= 1))]  # NaN is rejected, too
    if len(wrong):
        raise ValueError(f"pred: expected numbers in [0, 1], got {float(wrong[0]):g} and {len(wrong) - 1} others")


def _check_boundaries(boundaries: Sequence[Tensor], pred: Tensor) -> None:
    if len(boundaries) == 0:
        raise ValueError("boundaries: expected at least one annotator's, got none")
    for i, boundary in enumerate(boundaries):
        if boundary.dtype != torch.bool:
            raise TypeError(f"boundaries[{i}]: expected dtype torch.bool, got {boundary.dtype}")
        if boundary.shape != pred.shape:
            raise ValueError(
                f"pred: expected the shape of the boundaries, {list(boundary.shape)}, got {list(pred.shape)}"
            )
