"""Scores of boundary detectors: cases by hand, thinning, errors, and some of the real images."""

from __future__ import annotations

import re

import pytest
import torch
from bsds_files import write_bsds
from torch import Tensor, nn
from torchjoint_lab.datasets.bsds import bsds_images
from torchjoint_lab.evaluation.boundary_scores import (
    BoundaryCounts,
    boundary_counts,
    boundary_scores,
    evaluate_boundaries,
    evaluate_predictions,
    even_thresholds,
)
from torchjoint_lab.evaluation.skeleton import thin

from torchjoint.images.boundary import GradientBoundary
from torchjoint.images.contours import suppress_non_maxima

HEIGHT, WIDTH = 240, 320  # a diagonal of 400: matches up to 3 pixels
HALF = torch.tensor([0.5])
NAN = float("nan")


def column(at: int, strength: float = 1.0) -> Tensor:
    image = torch.zeros(HEIGHT, WIDTH)
    image[:, at] = strength
    return image


def counts(*rows: tuple[int, int, int, int]) -> BoundaryCounts:
    """A row for each threshold: predicted, matched, the annotators', matched."""
    return BoundaryCounts(*torch.tensor(rows).unbind(1))


@pytest.mark.parametrize(("shift", "is_right"), [(0, 1), (2, 1), (3, 1), (4, 0), (-3, 1), (-4, 0)])
def test_a_shift(shift, is_right):
    found = boundary_counts(column(100 + shift), [column(100) > 0], HALF)
    assert [int(value) for value in found] == [HEIGHT, HEIGHT * is_right, HEIGHT, HEIGHT * is_right]
    scores = boundary_scores([found], HALF)
    assert (scores.ods, scores.ois, scores.ods_precision, scores.ods_recall) == (is_right,) * 4


def test_two_annotators():
    """A line that only one of them drew is right, and recalls one of two lines."""
    found = boundary_counts(column(100) + column(200), [column(100) > 0, (column(102) + column(40)) > 0], HALF)
    assert [int(value) for value in found] == [2 * HEIGHT, HEIGHT, 3 * HEIGHT, 2 * HEIGHT]
    scores = boundary_scores([found], HALF)
    assert scores.ods_precision == 1 / 2
    assert scores.ods_recall == 2 / 3
    assert scores.ods == pytest.approx(4 / 7)


def test_two_lines_do_not_match_one():
    found = boundary_counts(column(99) + column(101), [column(100) > 0], HALF, nms=False)
    assert [int(value) for value in found] == [2 * HEIGHT, HEIGHT, HEIGHT, HEIGHT]


def test_thresholds_are_inclusive_and_nested():
    pred = column(100, 0.25) + column(200, 0.75)
    found = boundary_counts(pred, [column(100) > 0], torch.tensor([0.2, 0.25, 0.5, 0.75, 0.8]))
    assert (found.pred // HEIGHT).tolist() == [2, 2, 1, 1, 0]
    assert (found.pred_matched // HEIGHT).tolist() == [1, 1, 0, 0, 0]
    assert (found.target // HEIGHT).tolist() == [1] * 5


def test_ods_ois_and_ap():
    """Two images, two thresholds: F of both 2/3 and 2/3 together, but each image has its own best one."""
    thresholds = torch.tensor([0.2, 0.6])
    first, second = counts((30, 10, 10, 10), (10, 10, 10, 10)), counts((10, 10, 10, 10), (0, 0, 10, 0))
    scores = boundary_scores([first, second], thresholds)
    # Together: 20 of 40 right, 20 of 20 found; 10 of 10 right, 10 of 20 found.
    assert scores.curve.precision.tolist() == [0.5, 1]
    assert scores.curve.recall.tolist() == [1, 0.5]
    assert scores.curve.f.tolist() == pytest.approx([2 / 3, 2 / 3])
    assert (scores.ods_threshold, scores.ods_precision, scores.ods_recall) == (pytest.approx(0.2), 0.5, 1)
    assert scores.ods == pytest.approx(2 / 3)
    assert scores.ois == 1  # the first at 0.6, the second at 0.2
    # From recall .5 to 1 precision falls from 1 to .5; 51 of the 100 recalls are reached.
    assert scores.ap == pytest.approx(51 * 0.75 / 100)


def test_ap_of_points_with_the_same_recall_and_of_none():
    scores = boundary_scores([counts((40, 20, 20, 20), (20, 20, 20, 20), (0, 0, 20, 0))], torch.tensor([0.1, 0.2, 0.3]))
    assert scores.ap == pytest.approx(sum(i / 100 for i in range(1, 101)) / 100)  # from (0, 0) straight to (1, 1)
    assert boundary_scores([counts((0, 0, 20, 0))], HALF)[:6] == (0, 0.5, 0, 0, 0, 0)
    assert boundary_scores([counts((20, 20, 20, 20))], HALF).ap == 0.01


def test_even_thresholds():
    assert even_thresholds(99).tolist() == pytest.approx([i / 100 for i in range(1, 100)])
    for wrong in (0, -1, 1.5, True, "9"):
        with pytest.raises(ValueError, match="thresholds: expected a whole number >= 1"):
            even_thresholds(wrong)


# Thinning.


@pytest.mark.parametrize("angle", [0, 17, 45, 63, 90, 135, 160])
def test_a_blurred_line_becomes_thin(angle):
    """All that is left is on the line, within a pixel, and it has no gaps to speak of."""
    radians = torch.tensor(angle).deg2rad()
    y, x = torch.meshgrid(torch.arange(61.0) - 30, torch.arange(61.0) - 30, indexing="ij")
    distance = x * radians.cos() + y * radians.sin()
    lines = suppress_non_maxima(torch.exp(-distance.square() / 8))
    kept = (lines > 0)[10:-10, 10:-10]
    assert float(distance[10:-10, 10:-10][kept].abs().max()) <= 0.75
    length = 41 / max(abs(float(radians.cos())), abs(float(radians.sin())))
    assert 0.9 * 41 <= int(kept.sum()) <= 1.5 * length


def test_plateaus_stay_until_they_are_thinned():
    square = torch.zeros(30, 30)
    square[8:20, 5:25] = 1
    assert torch.equal(suppress_non_maxima(square), square)
    lines = thin(square > 0)
    assert 0 < int(lines.sum()) < 24
    assert not (lines & (square == 0)).any()
    flat = torch.full((5, 7), 0.25)
    assert torch.equal(suppress_non_maxima(flat), flat)


def test_thinning_at_the_border_and_of_small_squares():
    frame = torch.zeros(12, 12, dtype=torch.bool)
    frame[:2] = True
    assert thin(frame).any(0).sum() >= 10
    assert int(thin(frame).sum()) <= 12
    square = torch.zeros(6, 6, dtype=torch.bool)
    square[2:4, 2:4] = True
    assert int(thin(square).sum()) >= 1


def test_thinning_of_tiny_maps():
    for shape in ((0, 0), (0, 4), (1, 1), (1, 5)):
        assert suppress_non_maxima(torch.ones(shape)).shape == shape
    with pytest.raises(ValueError, match=re.escape("boundary: expected shape [H, W], got [1, 2, 3]")):
        suppress_non_maxima(torch.ones(1, 2, 3))


# Errors, and data.


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"pred": column(3) > 0}, TypeError, "pred: expected a floating tensor, got torch.bool"),
        ({"pred": [[1.0]]}, TypeError, "pred: expected a floating tensor, got list"),
        ({"pred": column(3)[None]}, ValueError, "pred: expected shape [H, W], got [1, 240, 320]"),
        ({"pred": column(3, 1.5)}, ValueError, "pred: expected numbers in [0, 1], got 1.5 and 239 others"),
        ({"pred": column(3, NAN)}, ValueError, "pred: expected numbers in [0, 1], got nan"),
        ({"pred": torch.ones(4, 5)}, ValueError, "pred: expected the shape of the boundaries, [240, 320], got [4, 5]"),
        ({"boundaries": []}, ValueError, "boundaries: expected at least one annotator's, got none"),
        ({"boundaries": [column(3)]}, TypeError, "boundaries[0]: expected dtype torch.bool, got torch.float32"),
        ({"thresholds": torch.tensor([0.0])}, ValueError, "thresholds: expected numbers in (0, 1]"),
        ({"thresholds": torch.tensor(0.5)}, ValueError, "thresholds: expected numbers in (0, 1], of shape [T]"),
    ],
)
def test_errors(change, error, message):
    right = {"pred": column(3), "boundaries": [column(3) > 0], "thresholds": HALF}
    with pytest.raises(error, match=re.escape(message)):
        boundary_counts(**right | change)


def test_errors_of_the_sum():
    with pytest.raises(ValueError, match="counts: expected those of at least one image, got none"):
        boundary_scores([], HALF)
    with pytest.raises(ValueError, match=re.escape("counts: expected tensors of shape [T] = [1]")):
        boundary_scores([counts((1, 1, 1, 1), (1, 1, 1, 1))], HALF)


class Blind(nn.Module):
    def forward(self, images: Tensor) -> Tensor:
        return torch.zeros_like(images[:, 0])


def test_a_tiny_data_set(tmp_path):
    left_and_right = (torch.arange(60) >= 30).long().repeat(40, 1).numpy() + 1
    records = bsds_images(write_bsds(tmp_path, {"a": [left_and_right], "b": [left_and_right, left_and_right]}), "val")
    scores = evaluate_boundaries(GradientBoundary(), records, 9)
    assert scores.ods == scores.ois == 1
    assert evaluate_boundaries(Blind(), records, 3).ods == 0
    assert evaluate_predictions(lambda record: record.boundaries[0].float(), records, 3).ods == 1
    with pytest.raises(ValueError, match="image a: pred: expected the shape of the boundaries"):
        evaluate_predictions(lambda record: torch.zeros(3, 3), records, 3)


def test_the_number_of_threads_does_not_matter(tmp_path, set_threads):
    generator = torch.Generator().manual_seed(0)
    regions = {name: [torch.randint(1, 3, (30, 40), generator=generator).numpy()] for name in "abc"}
    records = bsds_images(write_bsds(tmp_path, regions), "val")
    results = []
    for number in (1, 2):
        set_threads(number)
        results.append(evaluate_boundaries(GradientBoundary(), records, 9))
    assert results[0][:6] == results[1][:6]
    assert all(torch.equal(a, b) for a, b in zip(results[0].curve, results[1].curve, strict=True))


def test_real_images(shared):
    records = bsds_images(shared / "data" / "bsds500", "train")[:1]
    # An annotator scored against all: what they share is found, what they do not agree on costs recall.
    human = evaluate_predictions(lambda record: record.boundaries[0].float(), records, 1)
    assert human.ods_precision > 0.99
    assert 0.6 < human.ods_recall < 1
    gradient = evaluate_boundaries(GradientBoundary(), records, 4)
    assert 0.3 < gradient.ods <= gradient.ois < human.ods
    assert (gradient.curve.recall.diff() <= 0).all()
