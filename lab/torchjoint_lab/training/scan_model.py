"""Trains the model of step 6, method scan: are the parts of a node of a scan's tree better than the node?"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchjoint.config import ScanConfig
from torchjoint.runtime.messages import needed_for
from torchjoint.runtime.threads import one_thread_per_operation
from torchjoint.segments.learned.boundary_model import BoundaryModel, MemberModel
from torchjoint.segments.scan.method import scan_tree
from torchjoint.segments.scan.recognition import directions, find_rings
from torchjoint.segments.scan.tree import FEATURE_NAMES, Tree, summed_up
from torchjoint_lab.benchmark.disturbances import moved
from torchjoint_lab.benchmark.real_scenes import LIDAR, SAME_SENSOR, find_real_scenes
from torchjoint_lab.evaluation.partial_truth import PartialTruth
from torchjoint_lab.synthetic import LIDARS, make_domain_scene
from torchjoint_lab.training.boundary_model import no_calibration, trees_of_classifier

#: The value of a thing's best segment is half its IoU, half a step at .5 that is as steep as this.
STEEPNESS = 12.0
#: What each further segment of a thing costs, and from how many points on.
FRAGMENT, WHOLE_FRAGMENT = 0.15, 15
#: Weight of houses, trees and hedges of generated streets, beside 1 of things that real scans know.
OF_OTHERS = 0.25
#: Weight of an example of a real scan beside that of a generated one.
OF_REAL = 3.0
#: Smallest gain or loss of an example.
LEAST_GAIN = 1e-3


class Example(NamedTuple):
    """The inner nodes of a scan's tree."""

    sensor: str  #: a set of real scans, or "" for a generated one
    features: Tensor  #: [I, F] float32
    gain: Tensor  #: [I] float64, what it gains if the node falls into its parts


def street_examples(seeds: Iterable[int]) -> Iterator[Example]:
    """Each street as two kinds of sensors see it."""
    kinds = tuple(LIDARS)
    for seed in seeds:
        for kind in (kinds[2 * seed % len(kinds)], kinds[(2 * seed + 1) % len(kinds)]):
            made = make_domain_scene("street", seed, num_views=1, lidar=kind)
            assert made.scene.truth is not None
            assert made.scene.truth.points is not None
            known = made.scene.truth.points
            of_all = torch.unique(made.point_labels[made.point_labels >= 0])
            weight = torch.where(torch.isin(of_all, known), 1.0, OF_OTHERS).double()
            yield _example("", made.scene.points, _all_counts(made.point_labels), weight)


def real_examples(data: Path) -> Iterator[Example]:
    """Each real scan: moved twice, with half of its rings, and with three fifths of its points."""
    for one in find_real_scenes(data, tuple(name for name in LIDAR if (data / name).is_dir())):
        scene, truth = one.load()
        for number in range(4):
            random = torch.Generator().manual_seed(number)
            kept = torch.ones(len(scene.points), dtype=torch.bool)
            if number == 2:
                kept = _every_second_ring(scene.points, random)
            elif number == 3:
                kept = torch.rand(len(kept), generator=random) < 0.6
            points = moved(scene.points[kept], 0.01, random)
            some = PartialTruth(truth.instance[kept], truth.other[kept])
            things = torch.unique(some.instance[some.instance >= 0])
            yield _example(SAME_SENSOR.get(one.set, one.set), points, some, torch.ones(len(things)).double())


def _all_counts(labels: Tensor) -> PartialTruth:
    return PartialTruth(labels.long(), torch.zeros(len(labels), dtype=torch.bool))


def _every_second_ring(points: Tensor, random: torch.Generator) -> Tensor:
    rings = find_rings(points.float())
    if rings is None:
        return torch.rand(len(points), generator=random) < 0.5
    row = directions(points.float()).elevation / (2 * rings.step) + torch.rand(1, generator=random)
    return row - row.floor() < 0.5


def _example(sensor: str, points: Tensor, truth: PartialTruth, weight: Tensor) -> Example:
    with torch.no_grad(), one_thread_per_operation():
        tree = scan_tree(points, ScanConfig(), "search")
    return Example(sensor, tree.features, gains(tree, truth, weight)[tree.inner])


def gains(tree: Tree, truth: PartialTruth, weight: Tensor) -> Tensor:
    """What each of the M nodes gains if its parts are segments instead of the node, [M] float64.

    Gained is the value of the best part of each thing over that of the node; each other part that is mostly of one
    thing costs FRAGMENT.

    Args:
        tree: of a scan.
        truth: of its points.
        weight: [T] of the things, in ascending order of their instances.
    """
    count = len(tree.parent)
    instance = truth.instance[tree.which]
    ids, size = torch.unique(truth.instance[truth.instance >= 0], return_counts=True)
    if not len(ids):
        return torch.zeros(count, dtype=torch.float64)
    known = torch.nonzero(instance >= 0).squeeze(1)
    common = torch.zeros(count, len(ids) + 1, dtype=torch.float64)
    place = torch.searchsorted(ids, instance[known])
    common.index_put_((tree.superpoint[known], place), torch.ones(len(known)).double(), accumulate=True)
    common[:, -1].index_add_(0, tree.superpoint, truth.counts[tree.which].double())
    common = summed_up(common, tree.parent, tree.level)
    area, common = common[:, -1:], common[:, :-1]
    iou = common / (area + size - common).clamp(min=1)
    value = 0.5 * iou + 0.5 * torch.sigmoid(STEEPNESS * (iou - 0.5)) - 0.5 * torch.sigmoid(torch.tensor(-STEEPNESS / 2))
    parts = torch.nonzero(tree.parent >= 0).squeeze(1)
    above = tree.parent[parts]
    best = torch.zeros_like(iou).scatter_reduce_(0, above[:, None].expand(-1, len(ids)), iou[parts], "amax")
    best_value = torch.zeros_like(iou).scatter_reduce_(0, above[:, None].expand(-1, len(ids)), value[parts], "amax")
    gain = ((best_value - value) * weight).sum(1)
    most = common.argmax(1)
    points = summed_up(torch.bincount(tree.superpoint, minlength=count).double()[:, None], tree.parent, tree.level)[
        :, 0
    ]
    cost = FRAGMENT * weight[most] * (points / WHOLE_FRAGMENT).clamp(max=1)
    cost *= common.gather(1, most[:, None])[:, 0] > 0.5 * area[:, 0].clamp(min=1)
    cost = cost[parts] * (iou[parts, most[parts]] < best[above, most[parts]])
    return gain.index_add_(0, above, -cost)


def fit_scan_model(examples: Sequence[Example], without: str = "", members: int = 3) -> BoundaryModel:
    """The model of all examples but those of one sensor; equal examples make equal models."""
    with needed_for("training a model of scans", "scikit-learn", "torchjoint-lab"):
        from sklearn.ensemble import HistGradientBoostingClassifier
    used = [one for one in examples if not one.sensor or one.sensor != without]
    features, gain = (torch.cat([getattr(one, name) for one in used]).numpy() for name in ("features", "gain"))
    weight = np.concatenate([np.full(len(one.gain), OF_REAL if one.sensor else 1.0) for one in used])
    weight *= np.minimum(abs(gain), 1)
    tells = weight > LEAST_GAIN
    made = []
    for seed in range(members):
        classifier = HistGradientBoostingClassifier(
            max_iter=200, learning_rate=0.06, max_leaf_nodes=15, min_samples_leaf=40, l2_regularization=1.0,
            early_stopping=False, random_state=seed, max_features=0.5,
        )  # fmt: skip
        classifier.fit(features[tells], gain[tells] > 0, sample_weight=weight[tells] / weight[tells].mean())
        made.append(MemberModel((0.5,), FEATURE_NAMES, (trees_of_classifier(classifier),), (no_calibration(),)))
    return BoundaryModel(tuple(made))
