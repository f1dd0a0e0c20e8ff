"""ScanNet's average precision against sets and fractions written from its rules, and by hand."""

from __future__ import annotations

from fractions import Fraction
from statistics import fmean

import pytest
import torch
from effort import few_and_many
from hypothesis import strategies as st

from torchjoint.metrics import ScannetAveragePrecisionMetric, scannet_average_precision

# --- sets and fractions -----------------------------------------------------------------------------------------------


def slow_precision(scenes, min_size):
    """AP, AP50 and AP25 of scenes (masks as sets of points, their scores, the true labels)."""
    at = {
        k: slow_area([slow_matches(*scene, min_size, Fraction(k, 20)) for scene in scenes]) for k in [5, *range(10, 19)]
    }
    return fmean(at[k] for k in range(10, 19)), at[10], at[5]


def slow_matches(masks, scores, target, min_size, threshold):
    """How many instances there are; the scores of true and of false positives."""
    instances = [{k for k, t in enumerate(target) if t == label} for label in sorted(set(target) - {-1})]
    counted = [one for one in instances if len(one) >= min_size]
    ignored = {k for k in range(len(target)) if not any(k in one for one in counted)}
    masks = [(mask, score) for mask, score in zip(masks, scores, strict=True) if len(mask) >= min_size]
    used, true, false = [], [], []
    for instance in counted:
        best = None
        for k, (mask, score) in enumerate(masks):
            if k in used or Fraction(len(mask & instance), len(mask | instance)) <= threshold:
                continue
            if best is None:
                best = score
                used.append(k)
            else:
                false.append(min(best, score))
                best = max(best, score)
        true += [] if best is None else [best]
    for mask, score in masks:
        matches = any(Fraction(len(mask & one), len(mask | one)) > threshold for one in counted)
        if not matches and Fraction(len(mask & ignored), len(mask)) <= threshold:
            false.append(score)
    return len(counted), true, false


def slow_area(matches):
    count = sum(one[0] for one in matches)
    true = [score for one in matches for score in one[1]]
    false = [score for one in matches for score in one[2]]
    if count == 0:
        return float("nan")
    area, before = 0.0, (0.0, 1.0)
    for score in sorted({*true, *false}, reverse=True):
        hits = sum(one >= score for one in true)
        point = hits / count, hits / (hits + sum(one >= score for one in false))
        area += (point[0] - before[0]) * (point[1] + before[1]) / 2
        before = point
    return area


SCORES = st.one_of(st.sampled_from([0.0, 0.25, 0.5, 1.0]), st.floats(-5, 5))


@st.composite
def targets(draw):
    """Few instances, most of some size."""
    labels = st.sampled_from([-1, 0, 0, 0, 1, 1, 1, 7, 8])
    target = draw(st.lists(labels, min_size=1, max_size=20))
    return target if max(target) >= 0 else [*target, 0]


@st.composite
def scenes(draw):
    """Masks that may overlap, empty ones too; many of them near an instance."""
    target = draw(targets())
    points = st.integers(0, len(target) - 1)
    masks = []
    for _ in range(draw(st.integers(0, 5))):
        label = draw(st.sampled_from(target))
        start = {k for k, t in enumerate(target) if t == label} if draw(st.booleans()) else set()
        masks.append(start ^ draw(st.sets(points, max_size=4)))
    return masks, draw(st.lists(SCORES, min_size=len(masks), max_size=len(masks))), target


def as_masks(masks, size):
    result = torch.zeros(len(masks), size, dtype=torch.bool)
    for row, mask in zip(result, masks, strict=True):
        row[list(mask)] = True
    return result


def as_points(masks):
    return [torch.tensor(list(mask), dtype=torch.int64) for mask in masks]


def same(found, expected):
    return found == pytest.approx(expected, abs=1e-12, nan_ok=True)


@few_and_many(40, 100, scene=scenes(), min_size=st.integers(1, 4))
def test_masks_are_as_sets(scene, min_size):
    masks, scores, target = scene
    arguments = torch.tensor(target), torch.tensor(scores, dtype=torch.float64)
    expected = slow_precision([scene], min_size)
    assert same(scannet_average_precision(as_masks(masks, len(target)), *arguments, min_size=min_size), expected)
    assert same(scannet_average_precision(as_points(masks), *arguments, min_size=min_size), expected)


@few_and_many(40, 100, target=targets(), data=st.data(), min_size=st.integers(1, 4))
def test_labels_are_as_sets(target, data, min_size):
    size = len(target)
    mixed = st.tuples(st.integers(-1, 8), st.booleans())
    pred = [
        t if keep else p
        for t, (p, keep) in zip(target, data.draw(st.lists(mixed, min_size=size, max_size=size)), strict=True)
    ]
    scores = data.draw(st.lists(SCORES, min_size=9, max_size=9))
    labels = sorted(set(pred) - {-1})
    masks = [{k for k, p in enumerate(pred) if p == label} for label in labels]
    expected = slow_precision([(masks, [scores[label] for label in labels], target)], min_size)
    tensors = torch.tensor(pred), torch.tensor(target)
    assert same(
        scannet_average_precision(*tensors, torch.tensor(scores, dtype=torch.float64), min_size=min_size), expected
    )
    alike = slow_precision([(masks, [1] * len(masks), target)], min_size)
    assert same(scannet_average_precision(*tensors, min_size=min_size), alike)


@few_and_many(40, 100, several=st.lists(scenes(), min_size=1, max_size=4), min_size=st.integers(1, 3))
def test_scenes_make_one_curve(several, min_size):
    metric = ScannetAveragePrecisionMetric(min_size)
    for masks, scores, target in several:
        metric.update(as_points(masks), torch.tensor(target), torch.tensor(scores, dtype=torch.float64))
    assert same(metric.compute(), slow_precision(several, min_size))


@few_and_many(40, 100, scene=scenes(), random=st.randoms(use_true_random=False))
def test_order_and_numbers_do_not_matter_from_50_up(scene, random):
    masks, scores, target = scene
    before = scannet_average_precision(as_points(masks), torch.tensor(target), torch.tensor(scores), min_size=1)
    order = random.sample(range(len(masks)), len(masks))
    number = dict(zip(sorted(set(target) - {-1}), random.sample(range(10**12), 4), strict=False)) | {-1: -1}
    after = scannet_average_precision(
        as_points([masks[k] for k in order]),
        torch.tensor([number[t] for t in target]),
        torch.tensor(scores)[order],
        min_size=1,
    )
    assert same(after[:2], before[:2])


# --- by hand ----------------------------------------------------------------------------------------------------------


def runs(*pairs):
    """Labels from (label, how many) pairs."""
    labels, counts = torch.tensor(pairs).unbind(1)
    return labels.repeat_interleave(counts)


def test_a_perfect_prediction_has_1():
    target = runs((3, 100), (-1, 50), (5, 400))
    assert scannet_average_precision(target, target) == (1.0, 1.0, 1.0)
    assert scannet_average_precision(target, [target, target]) == (1.0, 1.0, 1.0)


def test_without_scores_the_curve_is_one_point():
    """Of two instances one is found, by one of two predictions: recall 1/2, precision 1/2."""
    target, pred = runs((0, 200), (1, 200)), runs((0, 200), (1, 100), (2, 100))
    assert scannet_average_precision(pred, target).ap == pytest.approx(0.5 * (1 + 1 / 3) / 2)
    assert scannet_average_precision(runs((0, 200), (1, 90), (2, 110)), target).ap50 == pytest.approx(1.0 * (1 + 1) / 2)


@pytest.mark.parametrize(("scores", "expected"), [((0.9, 0.1), 1.0), ((0.1, 0.9), 0.25), ((0.5, 0.5), 0.75)])
def test_a_false_positive_hurts_only_above_the_true_one(scores, expected):
    """The second mask matches nothing. Curves: (0,1) (1,1) (1,1/2), then (0,1) (0,0) (1,1/2), then (0,1) (1,1/2)."""
    target = runs((0, 200), (1, 99))
    masks = torch.stack([target == 0, torch.arange(299) < 100])
    assert scannet_average_precision(masks, target, torch.tensor(scores)).ap50 == pytest.approx(expected)


def test_of_masks_of_one_instance_the_best_score_is_right():
    """Once more is a false positive; it is the higher score that counts as true, whatever the IoU."""
    target = runs((0, 200), (1, 200))
    first, second = torch.arange(400) < 200, torch.arange(400) < 150
    for masks in (torch.stack([first, second]), torch.stack([second, first])):
        result = scannet_average_precision(masks, target, torch.tensor([0.3, 0.8]))
        assert result.ap50 == pytest.approx(0.5)  # recall 1/2 at precision 1, then nothing but a false positive


def test_an_iou_at_the_threshold_is_no_match():
    target = runs((0, 200), (1, 600))
    assert scannet_average_precision(runs((0, 100), (-1, 700)), target).ap50 == 0.0
    assert scannet_average_precision(runs((0, 101), (-1, 699)), target).ap50 == 0.5
    at_90 = 0.5 * (1 + 0.5) / 2  # one of two, and a false positive
    assert scannet_average_precision(runs((0, 180), (-1, 20), (2, 600)), target).ap == pytest.approx((8 + at_90) / 9)


def test_void_counts_in_the_area_of_a_mask():
    """150 points of 200 void: IoU 200/350 instead of 1."""
    target = runs((0, 200), (-1, 150))
    result = scannet_average_precision(runs((0, 350)), target)
    assert (result.ap50, result.ap25) == (1.0, 1.0)
    assert result.ap == pytest.approx(2 / 9)  # .50 and .55 are below 200/350 = .571


@pytest.mark.parametrize(("void", "expected"), [(0, 0.75), (100, 0.75), (101, 1.0), (149, 1.0)])
@pytest.mark.parametrize("label", [-1, 5])
def test_a_mask_of_void_or_a_tiny_instance_is_no_error(void, expected, label):
    """A mask of 200 points that matches nothing: at a threshold of .50 it counts unless more than half is ignored."""
    target, pred = runs((0, 300), (label, void), (0, 200 - void)), runs((0, 300), (1, 200))
    assert scannet_average_precision(pred, target, min_size=150).ap50 == pytest.approx(expected)


def test_instances_and_masks_below_the_least_size_are_left_out():
    target = runs((0, 100), (1, 99))
    assert scannet_average_precision(runs((0, 100), (1, 99)), target) == (1.0, 1.0, 1.0)
    assert scannet_average_precision(runs((0, 100), (-1, 99)), target) == (1.0, 1.0, 1.0)
    assert scannet_average_precision(runs((0, 99), (-1, 100)), target) == (0.0, 0.0, 0.0)
    assert scannet_average_precision(runs((0, 100), (-1, 99)), target, min_size=99).ap50 == 0.5


def test_without_predictions_it_is_0_and_without_instances_nan():
    target = runs((0, 150))
    for nothing in (-torch.ones(150, dtype=torch.int64), torch.zeros(0, 150, dtype=torch.bool), []):
        assert scannet_average_precision(nothing, target) == (0.0, 0.0, 0.0)
        assert all(value != value for value in scannet_average_precision(nothing, target, min_size=151))


def test_a_mask_of_two_instances_goes_to_the_first_taker():
    """Only below 0.5 do numbers matter: the second mask matches both instances, the first one only instance 0."""
    target, pred = runs((0, 100), (1, 50)), runs((0, 50), (1, 100))
    scores = torch.tensor([0.4, 0.8])
    found = scannet_average_precision(pred, target, scores, min_size=50)
    assert found.ap25 == 1.0  # instance 0 claims the first mask, so the second is left for instance 1
    masks = torch.stack([pred == 1, pred == 0])
    found = scannet_average_precision(masks, target, scores.flip(0), min_size=50)
    assert found.ap25 == 0.5  # instance 0 claims the mask that instance 1 needs


def test_pooling_is_not_averaging():
    target = runs((0, 100), (1, 100))
    good, bad = runs((0, 100), (1, 100)), runs((0, 50), (1, 100), (0, 50))
    metric = ScannetAveragePrecisionMetric()
    metric.update(good, target, torch.tensor([0.9, 0.8]))
    metric.update(bad, target, torch.tensor([0.95, 0.7]))
    # By score: false, true, true, false, of four instances.
    precision = [1, 0, 1 / 2, 2 / 3, 1 / 2]
    recall = [0, 0, 1 / 4, 2 / 4, 2 / 4]
    expected = sum((recall[i + 1] - recall[i]) * (precision[i] + precision[i + 1]) / 2 for i in range(4))
    assert metric.compute().ap50 == pytest.approx(expected)


def test_several_ground_truths_are_so_many_scenes():
    target, other = runs((0, 100), (1, 100)), runs((0, 200))
    pred, scores = runs((0, 100), (1, 100)), torch.tensor([0.9, 0.8])
    metric = ScannetAveragePrecisionMetric()
    metric.update(pred, target, scores)
    metric.update(pred, other, scores)
    assert scannet_average_precision(pred, [target, other], scores) == metric.compute()


def test_labels_may_have_any_shape():
    target, pred = runs((0, 100), (1, 100)), runs((0, 80), (1, 120))
    flat = scannet_average_precision(pred, target)
    assert scannet_average_precision(pred.view(10, 20), target.view(10, 20)) == flat
    masks = torch.stack([pred == 0, pred == 1]).view(2, 10, 20)
    assert scannet_average_precision(masks, target.view(10, 20)) == flat
    points = [(pred == k).nonzero().flatten() for k in range(2)]
    assert scannet_average_precision(points, target.view(10, 20)) == flat
    assert scannet_average_precision([torch.cat([one, one]) for one in points], target) == flat  # a set of points
    assert scannet_average_precision(pred * 10**15, target * 10**15) == flat


# --- errors -----------------------------------------------------------------------------------------------------------

T = torch.zeros(4, dtype=torch.int64)
MASKS = torch.ones(2, 4, dtype=torch.bool)


@pytest.mark.parametrize(
    ("pred", "scores", "error", "message"),
    [
        (T[:3], None, ValueError, r"pred: expected labels of the target's shape, \(4,\), got \(3,\)"),
        (T - 2, None, ValueError, "pred: expected labels >= -1, got -2"),
        (T.float(), None, TypeError, "pred: expected an integer tensor, got torch.float32"),
        (None, None, TypeError, "pred: expected labels, masks or a sequence of tensors of points, got NoneType"),
        (MASKS[:, :3], None, ValueError, r"pred: expected masks of shape \(K, 4\), got \(2, 3\)"),
        (MASKS[0], None, ValueError, r"pred: expected masks of shape \(K, 4\), got \(4,\)"),
        ([T, [0]], None, TypeError, r"pred\[1\]: expected an integer tensor of points, got list"),
        ([MASKS[0]], None, TypeError, r"pred\[0\]: expected an integer tensor of points, got torch.bool"),
        ([T.view(2, 2)], None, ValueError, r"pred\[0\]: expected points of shape \[M\], got \(2, 2\)"),
        ([T + 4], None, ValueError, r"pred\[0\]: expected points in 0 ... 3, got 4 ... 4"),
        ([T - 1], None, ValueError, r"pred\[0\]: expected points in 0 ... 3, got -1 ... -1"),
        (T, [1.0], TypeError, "scores: expected a tensor of real numbers, got <class 'list'>"),
        (T, torch.ones(9) * 1j, TypeError, "scores: expected a tensor of real numbers, got torch.complex64"),
        (T + 2, torch.ones(2), ValueError, r"scores: expected a score for each label up to 2, got \(2,\)"),
        (T, torch.tensor(1.0), ValueError, r"scores: expected a score for each label up to 0, got \(\)"),
        (MASKS, torch.ones(3), ValueError, r"scores: expected shape \(2,\), one for each mask, got \(3,\)"),
        (MASKS, torch.tensor([1.0, float("nan")]), ValueError, "scores: expected finite numbers"),
    ],
)
def test_bad_predictions(pred, scores, error, message):
    with pytest.raises(error, match=message):
        scannet_average_precision(pred, T, scores)


def test_bad_targets_and_sizes():
    with pytest.raises(ValueError, match=r"target: expected at least one label >= 0, got nothing but -1 \(void\)"):
        scannet_average_precision(T, T - 1)
    with pytest.raises(ValueError, match="target: expected at least one ground truth, got an empty sequence"):
        scannet_average_precision(T, [])
    with pytest.raises(TypeError, match="target: expected an integer tensor"):
        scannet_average_precision(T, MASKS[0])
    for size in (0, -5, float("nan")):
        with pytest.raises(ValueError, match="min_size: expected at least 1 point"):
            scannet_average_precision(T, T, min_size=size)
        with pytest.raises(ValueError, match="min_size: expected at least 1 point"):
            ScannetAveragePrecisionMetric(size)
