"""The measures against checked values, against loops written straight from their definition, and by hand."""

from __future__ import annotations

import json
from itertools import product

import pytest
import torch
from effort import few_and_many
from hypothesis import given
from hypothesis import strategies as st

from torchjoint import metrics

I64 = torch.iinfo(torch.int64)


# --- checked values ---------------------------------------------------------------------------------------------------


def decode(runs, shape):
    runs = torch.tensor(runs).view(-1, 2)
    return runs[:, 0].repeat_interleave(runs[:, 1]).view(shape)


@pytest.fixture(scope="session")
def cases(shared):
    """name -> (pred, [target], thresholds, expected values)"""
    result = {}
    for case in json.loads((shared / "metrics" / "cases.json").read_text())["cases"]:
        pred = decode(case["seg"], case["shape"])
        targets = [decode(one, case["shape"]) for one in case["gt"]]
        thresholds = (case["gamma_o"], case["gamma_p"], case["beta"])
        result[case["name"]] = pred, targets, thresholds, case["expect"]
    return result


def measured(pred, targets, thresholds):
    covering = metrics.segmentation_covering(pred, targets)
    found = metrics.objects_and_parts(pred, targets, *thresholds)
    return {
        "Pr": found.precision,
        "Re": found.recall,
        "F": found.f,
        "C_gt_by_seg": covering.target_by_pred,
        "C_seg_by_gt": covering.pred_by_target,
        "SSC": covering.symmetric,
        "AP_o_step": metrics.average_precision_objects(pred, targets),
        "AP_p_step": metrics.average_precision_parts(pred, targets),
    }


def test_checked_values(cases):
    wrong = {}
    for name, (pred, targets, thresholds, expected) in cases.items():
        # In these cases -1 is void on either side (one case, R21, has it in the prediction). Here an unlabelled
        # prediction is background instead, so what the case leaves out must be void in the target.
        targets = [torch.where(pred >= 0, target, -1) for target in targets]
        for key, value in measured(pred, targets, thresholds).items():
            if abs(value - expected[key]) > 1e-6:
                wrong[name, key] = value, expected[key]
    assert wrong == {}
    assert len(cases) >= 21


def test_one_checked_case_has_unlabelled_predictions(cases):
    assert [name for name, (pred, *_) in cases.items() if (pred < 0).any()] == ["R21"]


# --- loops ------------------------------------------------------------------------------------------------------------


def numbered(labels):
    """Region ids by first appearance."""
    seen = {}
    return [seen.setdefault(label, len(seen)) for label in labels]


def slow_candidates(ids):
    areas = {region: ids.count(region) for region in set(ids)}
    acc, chosen = 0.0, set()
    for region in sorted(areas, key=lambda region: (-areas[region], -region)):
        if acc < 0.99:
            chosen.add(region)
        acc += areas[region] / len(ids)
    return chosen


def slow_objects_and_parts(pred, targets, go, gp, beta):
    used = [k for k in range(len(pred)) if any(target[k] >= 0 for target in targets)]
    seg_of = dict(zip(used, numbered([pred[k] for k in used]), strict=True))
    cand_s = slow_candidates(list(seg_of.values()))
    class_s = {}
    frag_s = dict.fromkeys(seg_of.values(), 0.0)
    recalled = expected = 0
    for target in targets:
        inside = [k for k in used if target[k] >= 0]
        seg, gt = [seg_of[k] for k in inside], numbered([target[k] for k in inside])
        cand_g = slow_candidates(gt)
        class_g, frag_g = {}, dict.fromkeys(gt, 0.0)
        for i, j in product(range(max(gt) + 1), range(max(seg) + 1)):
            overlap = sum(s == j and g == i for s, g in zip(seg, gt, strict=True))
            if overlap == 0:
                continue
            rec, pre = overlap / gt.count(i), overlap / seg.count(j)
            if i in cand_g and j in cand_s:
                if rec >= go and pre >= go:
                    class_g[i] = class_s[j] = "object"
                elif rec >= gp and pre >= go:
                    class_s.setdefault(j, "part")
                elif rec >= go and pre >= gp:
                    class_g[i] = "part"
            if pre >= go and rec < go:
                frag_g[i] += rec
            if rec >= go and pre < go:
                frag_s[j] += pre / len(targets)
        recalled += slow_worth(class_g, frag_g, cand_g, beta)
        expected += len(cand_g)
    precision, recall = slow_worth(class_s, frag_s, cand_s, beta) / len(cand_s), recalled / expected
    return precision, recall, 2 * precision * recall / (precision + recall) if precision + recall else 0.0


def slow_worth(classes, fragments, candidates, beta):
    kinds = list(classes.values())
    return kinds.count("object") + beta * kinds.count("part") + sum(fragments[r] for r in candidates - set(classes))


def slow_ious(pred, target):
    """[(area, best IoU)] of the true regions."""
    pairs = [(p, t) for p, t in zip(pred, target, strict=True) if t >= 0]
    result = []
    for region in {t for _, t in pairs}:
        inside = {k for k, (_, t) in enumerate(pairs) if t == region}
        others = [{k for k, (p, _) in enumerate(pairs) if p == other} for other in {p for p, _ in pairs}]
        result.append((len(inside), max(len(inside & other) / len(inside | other) for other in others)))
    return result


def slow_covering(pred, target):
    best = slow_ious(pred, target)
    return sum(area * iou for area, iou in best) / sum(area for area, _ in best)


@st.composite
def partitions(draw, max_targets=3, void=True):
    """A prediction and ground truths, as lists; often coarse, so that large overlaps are not rare."""
    size = draw(st.integers(1, 24))
    labels = st.integers(-1 if void else 0, draw(st.integers(0, 6)))
    pred = draw(st.lists(labels, min_size=size, max_size=size))
    targets = []
    for _ in range(draw(st.integers(1, max_targets))):
        target = draw(st.lists(labels, min_size=size, max_size=size))
        for k in range(size):
            if draw(st.booleans()):
                target[k] = max(pred[k], 0)
        if max(target) < 0:
            target[draw(st.integers(0, size - 1))] = 0
        targets.append(target)
    return pred, targets


@st.composite
def thresholds(draw, least=1):
    gamma_object = draw(st.integers(least, 20))
    return gamma_object / 20, draw(st.integers(1, gamma_object)) / 20, draw(st.sampled_from([0.0, 0.1, 0.25, 1.0]))


@given(partitions(), thresholds())
def test_objects_and_parts_are_the_loop(data, gammas):
    pred, targets = data
    found = metrics.objects_and_parts(torch.tensor(pred), [torch.tensor(target) for target in targets], *gammas)
    assert found == pytest.approx(slow_objects_and_parts(pred, targets, *gammas), abs=1e-12)


@pytest.mark.parametrize("seed", range(20))
def test_objects_and_parts_equal_the_loop_without_small_regions(seed):
    generator = torch.Generator().manual_seed(seed)
    target = torch.multinomial(0.5 ** torch.arange(14.0), 400, True, generator=generator)
    pred = torch.where(torch.rand(400, generator=generator) < 0.1, target.flip(0), target)
    found = metrics.objects_and_parts(pred, target)
    assert found == pytest.approx(slow_objects_and_parts(pred.tolist(), [target.tolist()], 0.75, 0.25, 0.1), abs=1e-12)


@given(partitions())
def test_coverings_and_mean_best_iou_are_the_loop(data):
    pred, targets = data
    tensors = torch.tensor(pred), [torch.tensor(target) for target in targets]
    covering = metrics.segmentation_covering(*tensors)
    forth, back, best = [], [], []
    for target in targets:
        kept = [(p + 1, t) for p, t in zip(pred, target, strict=True) if t >= 0]  # + 1: unlabelled is a region
        forth.append(slow_covering([p for p, _ in kept], [t for _, t in kept]))
        back.append(slow_covering([t for _, t in kept], [p for p, _ in kept]))
        ious = [iou for _, iou in slow_ious([p for p, _ in kept], [t for _, t in kept])]
        best.append(sum(ious) / len(ious))
    forth, back, best = (sum(values) / len(values) for values in (forth, back, best))
    assert covering == pytest.approx(((forth + back) / 2, forth, back), abs=1e-12)
    assert metrics.mean_best_iou(*tensors) == pytest.approx(best, abs=1e-12)


def slow_superpoint_measures(pred, target):
    """Achievable segmentation accuracy and undersegmentation error, from sets of points."""
    labelled = [k for k, t in enumerate(target) if t >= 0]
    superpoints = [{k for k in labelled if pred[k] == label} for label in set(pred)]
    regions = [{k for k in labelled if target[k] == label} for label in {target[k] for k in labelled}]
    right = sum(max(len(superpoint & region) for region in regions) for superpoint in superpoints)
    leaked = sum(min(len(s & r), len(s - r)) for r in regions for s in superpoints if s & r)
    return right / len(labelled), leaked / len(labelled)


@given(partitions())
def test_superpoint_measures_are_the_loop(data):
    pred, targets = data
    tensors = torch.tensor(pred), [torch.tensor(target) for target in targets]
    each = [slow_superpoint_measures(pred, target) for target in targets]
    accuracy, error = (sum(values) / len(values) for values in zip(*each, strict=True))
    assert metrics.achievable_segmentation_accuracy(*tensors) == pytest.approx(accuracy, abs=1e-12)
    assert metrics.undersegmentation_error(*tensors) == pytest.approx(error, abs=1e-12)


# --- properties -------------------------------------------------------------------------------------------------------


def everything(pred, target):
    return (
        *metrics.segmentation_covering(pred, target),
        *metrics.objects_and_parts(pred, target),
        metrics.mean_best_iou(pred, target),
        metrics.average_precision_objects(pred, target),
        metrics.average_precision_parts(pred, target),
        metrics.achievable_segmentation_accuracy(pred, target),
        1 - metrics.undersegmentation_error(pred, target),
    )


@few_and_many(15, 50, data=partitions(), random=st.randoms(use_true_random=False))
def test_which_number_a_region_has_does_not_matter(data, random):
    def renumbered(labels, void):
        old = sorted(set(labels))
        fresh = random.sample([*range(8), 10**9, 10**18, I64.max - 1, I64.max], len(old))
        new = dict(zip(old, fresh, strict=True)) | ({-1: -1} if void else {})
        return torch.tensor([new[label] for label in labels])

    pred, targets = data
    before = everything(torch.tensor(pred), [torch.tensor(target) for target in targets])
    assert everything(renumbered(pred, False), [renumbered(target, True) for target in targets]) == before


@pytest.mark.parametrize("seed", range(5))
def test_the_order_of_the_points_does_not_matter_without_ties(seed):
    generator = torch.Generator().manual_seed(seed)
    target = torch.multinomial(0.6 ** torch.arange(9.0), 3000, True, generator=generator)
    pred = torch.where(torch.rand(3000, generator=generator) < 0.1, 8 - target, target // 2)
    for labels in (pred, target):
        areas = labels.unique(return_counts=True)[1]
        assert len(areas.unique()) == len(areas)
    order = torch.randperm(3000, generator=generator)
    assert everything(pred[order], target[order]) == pytest.approx(everything(pred, target), abs=1e-12)


@given(partitions(max_targets=1, void=False), thresholds(least=11))
def test_swapping_the_sides_swaps_precision_and_recall(data, gammas):
    pred, target = torch.tensor(data[0]), torch.tensor(data[1][0])
    one, other = metrics.objects_and_parts(pred, target, *gammas), metrics.objects_and_parts(target, pred, *gammas)
    assert (one.precision, one.recall, one.f) == pytest.approx((other.recall, other.precision, other.f), abs=1e-12)
    one, other = metrics.segmentation_covering(pred, target), metrics.segmentation_covering(target, pred)
    assert one == pytest.approx((other.symmetric, other.pred_by_target, other.target_by_pred), abs=1e-12)


@few_and_many(15, 50, data=partitions())
def test_everything_is_between_0_and_1_and_the_same_twice(data):
    pred, targets = torch.tensor(data[0]), [torch.tensor(target) for target in data[1]]
    values = everything(pred, targets)
    assert all(type(value) is float and 0 <= value <= 1 + 1e-12 for value in values)
    assert everything(pred, targets) == values


@few_and_many(15, 50, data=partitions())
def test_a_perfect_prediction_has_1_everywhere(data):
    target = torch.tensor(data[1][0])
    assert everything(target, target) == pytest.approx([1.0] * 11)


def test_few_and_many_regions_give_the_same_table():
    few = torch.arange(6000).view(60, 100) // 50
    pred, target = few // 3, few // 2
    assert everything(pred * 10**12, target * 10**15) == everything(pred, target)
    every = torch.arange(6000)  # 6000 x 6000 pairs: too many to count in an array
    assert everything(every, every.flip(0)) == pytest.approx([1.0] * 11)


# --- by hand ----------------------------------------------------------------------------------------------------------


def test_covering_by_hand():
    pred, target = torch.tensor([0, 0, 0, 1]), torch.tensor([0, 0, 1, 1])
    covering = metrics.segmentation_covering(pred, target)
    assert covering.target_by_pred == pytest.approx((2 * 2 / 3 + 2 * 1 / 2) / 4)
    assert covering.pred_by_target == pytest.approx((3 * 2 / 3 + 1 * 1 / 2) / 4)
    assert covering.symmetric == pytest.approx((covering.target_by_pred + covering.pred_by_target) / 2)


def test_mean_best_iou_counts_a_small_instance_like_a_large_one():
    pred, target = torch.tensor([0] * 9 + [0]), torch.tensor([0] * 9 + [1])
    assert metrics.mean_best_iou(pred, target) == pytest.approx((9 / 10 + 1 / 10) / 2)
    assert metrics.segmentation_covering(pred, target).target_by_pred == pytest.approx((9 * 9 / 10 + 1 / 10) / 10)


def test_superpoint_measures_by_hand():
    """Superpoints of 4 and 2 points; the first lies 3:1 over two regions, the second within one."""
    pred, target = torch.tensor([0, 0, 0, 0, 1, 1]), torch.tensor([0, 0, 0, 1, 1, 1])
    assert metrics.achievable_segmentation_accuracy(pred, target) == pytest.approx((3 + 2) / 6)
    assert metrics.undersegmentation_error(pred, target) == pytest.approx((1 + 1 + 0) / 6)
    one = torch.zeros(6, dtype=torch.int64)  # a single superpoint, half of it in either region
    assert metrics.achievable_segmentation_accuracy(one, target) == 0.5
    assert metrics.undersegmentation_error(one, target) == 1.0


def test_splitting_superpoints_never_hurts_what_is_achievable():
    generator = torch.Generator().manual_seed(0)
    target = torch.randint(5, (2000,), generator=generator)
    pred = torch.randint(40, (2000,), generator=generator)
    coarse, fine = pred // 4, pred * 2 + torch.randint(2, (2000,), generator=generator)
    accuracy = [metrics.achievable_segmentation_accuracy(p, target) for p in (coarse, pred, fine)]
    assert accuracy == sorted(accuracy)
    assert accuracy[0] < accuracy[2]


def test_void_is_dropped_with_what_was_predicted_there():
    pred, target = torch.tensor([3, 3, 4, 4, 9, 3]), torch.tensor([1, 1, 2, 2, -1, -1])
    assert everything(pred, target) == pytest.approx([1.0] * 11)


def test_an_unlabelled_prediction_is_one_background_region():
    target = torch.tensor([0, 0, 1, 1, 2, 2])
    unlabelled = everything(torch.tensor([0, 0, -1, -1, -1, -1]), target)
    assert unlabelled == everything(torch.tensor([0, 0, 7, 7, 7, 7]), target)
    assert metrics.segmentation_covering(torch.full((6,), -1), target).target_by_pred == pytest.approx(1 / 3)


def test_several_ground_truths_with_different_void():
    pred = torch.tensor([0, 0, 1, 1])
    targets = [torch.tensor([0, 0, -1, -1]), torch.tensor([-1, -1, 0, 0])]
    assert metrics.objects_and_parts(pred, targets) == (1.0, 1.0, 1.0)
    assert metrics.segmentation_covering(pred, targets) == (1.0, 1.0, 1.0)


def test_one_ground_truth_may_come_alone_or_in_a_sequence():
    pred, target = torch.tensor([[0, 0], [1, 1]]), torch.tensor([[0, 1], [1, -1]])
    assert everything(pred, target) == everything(pred, [target]) == everything(pred, (target, target))


def test_the_shape_and_strides_do_not_matter():
    pred, target = torch.arange(24).view(2, 3, 4) // 5, torch.arange(24).view(2, 3, 4) // 7
    flat = everything(pred.transpose(0, 2).flatten(), target.transpose(0, 2).flatten())
    assert everything(pred.transpose(0, 2), target.transpose(0, 2)) == flat


def test_arguments_are_left_as_they_were():
    pred, target = torch.tensor([-1, 5, 5]), torch.tensor([3, 3, -1])
    everything(pred, target)
    assert pred.tolist() == [-1, 5, 5]
    assert target.tolist() == [3, 3, -1]


# --- errors -----------------------------------------------------------------------------------------------------------


def test_what_may_be_void_in_8_bits_is_told():
    pred, target = torch.tensor([0, 0, 1, 2]), torch.tensor([0, 0, 255, 255], dtype=torch.uint8)
    for metric in (metrics.segmentation_covering, metrics.scannet_average_precision):
        with pytest.warns(UserWarning, match=r"^target: 255 is a region; if it was void or none"):
            metric(pred, target)
    assert metrics.segmentation_covering(pred, target.clamp(max=254)).symmetric < 1  # no doubt, no warning


ONES = torch.ones(4, dtype=torch.int64)


@pytest.mark.parametrize(
    "measure",
    [
        metrics.segmentation_covering,
        metrics.objects_and_parts,
        metrics.mean_best_iou,
        metrics.achievable_segmentation_accuracy,
        metrics.undersegmentation_error,
    ],
)
@pytest.mark.parametrize(
    ("pred", "target", "error", "message"),
    [
        (ONES, ONES[:3], ValueError, r"target: expected the shape of pred, \(4,\), got \(3,\)"),
        (ONES, ONES.view(2, 2), ValueError, r"target: expected the shape of pred, \(4,\), got \(2, 2\)"),
        (ONES, [ONES, ONES[:3]], ValueError, r"target\[1\]: expected the shape"),
        (ONES.float(), ONES, TypeError, "pred: expected an integer tensor, got torch.float32"),
        (ONES, ONES.double(), TypeError, "target: expected an integer tensor, got torch.float64"),
        (ONES > 0, ONES, TypeError, "pred: expected an integer tensor, got torch.bool"),
        ([1, 1, 1, 1], ONES, TypeError, "pred: expected an integer tensor, got list"),
        (ONES, ONES.numpy(), TypeError, "target: expected an integer tensor, got ndarray"),
        (ONES, None, TypeError, "target: expected an integer tensor, got NoneType"),
        (ONES, ONES.to_sparse(), TypeError, "target: expected an integer tensor, got torch.sparse_coo"),
        (ONES, [1, 1, 1, 1], TypeError, r"target\[0\]: expected an integer tensor, got int"),
        (ONES, [], ValueError, "target: expected at least one ground truth, got an empty sequence"),
        (ONES, -ONES, ValueError, r"target: expected at least one label >= 0, got nothing but -1 \(void\)"),
        (ONES, [ONES, -ONES], ValueError, r"target\[1\]: expected at least one label >= 0"),
        (ONES[:0], ONES[:0], ValueError, r"pred: expected at least one label, got an empty tensor of shape \(0,\)"),
        (ONES, -2 * ONES, ValueError, "target: expected labels >= -1, got -2"),
        (-3 * ONES, ONES, ValueError, "pred: expected labels >= -1, got -3"),
    ],
)
def test_bad_labels(measure, pred, target, error, message):
    with pytest.raises(error, match=message):
        measure(pred, target)


@pytest.mark.parametrize(
    ("thresholds", "message"),
    [
        ({"gamma_object": 1.5}, r"gamma_object: expected a number in \(0, 1\], got 1.5"),
        ({"gamma_object": float("nan")}, "gamma_object: expected a number"),
        ({"gamma_part": 0.0}, r"gamma_part: expected a number in \(0, gamma_object = 0.75\], got 0.0"),
        ({"gamma_part": 0.8}, "gamma_part: expected a number"),
        ({"beta": -1}, r"beta: expected a number in \[0, 1\], got -1"),
    ],
)
def test_bad_thresholds(thresholds, message):
    with pytest.raises(ValueError, match=message):
        metrics.objects_and_parts(ONES, ONES, **thresholds)
