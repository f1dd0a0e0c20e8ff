"""Labelled LiDAR scans, and how they are scored; used by sensors.py and street_images.py.

In a full annotation, and on generated streets, things and ground are instances; houses and hedges are none, but count
where a segment mixes them with one: :mod:`torchjoint_lab.evaluation.partial_truth`.
"""

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from statistics import fmean
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torchjoint_lab.benchmark import spaces
from torchjoint_lab.benchmark.planes import planes_and_clusters
from torchjoint_lab.benchmark.space import draw
from torchjoint_lab.datasets.semantickitti import read_sweep
from torchjoint_lab.evaluation import partial_truth
from torchjoint_lab.evaluation.partial_truth import PartialTruth, Score
from torchjoint_lab.synthetic import make_domain_scene

from torchjoint.datasets import list_scenes, load_scene
from torchjoint.scene import Scene
from torchjoint.views.visibility import in_any_view

#: Seeds of generated streets on which settings may be chosen, and of those that check them.
SEEDS = {"develop": range(10), "check": range(10, 20)}


class Sweep(NamedTuple):
    """One labelled LiDAR scan."""

    name: str
    points: Tensor  #: [N, 3] metres
    instance: Tensor  #: [N] int64, -1 = none
    other: Tensor  #: [N] bool, points of no instance that count where they leak into one


def kitti(data: Path) -> Iterator[Sweep]:
    """Points in boxes, in the camera's view; what is outside all boxes is void."""
    for name, path in list_scenes(data / "kitti" / "training").items():
        scene = load_scene(path)
        scene = scene.select_points(in_any_view(scene.points, scene.frames))
        instance = known_instances(scene)
        yield Sweep(name, scene.points, instance, torch.zeros_like(instance, dtype=torch.bool))


def semantickitti(data: Path) -> Iterator[Sweep]:
    """Every vehicle and person an instance, all ground one."""
    for path in sorted((data / "semantickitti").glob("*.bin")):
        sweep = read_sweep(path)
        yield Sweep(path.stem, sweep.points, sweep.instance, (sweep.instance < 0) & ~sweep.void)


def streets(half: str) -> Iterator[Sweep]:
    """Generated streets."""
    yield from map(street, SEEDS[half])


def street(seed: int, lidar: str | None = None) -> Sweep:
    """A generated street; vegetation, houses and fences are no instances."""
    made = make_domain_scene("street", seed, num_views=1, lidar=lidar)
    instance = known_instances(made.scene)
    other = (instance < 0) & (made.point_labels >= 0)
    return Sweep(made.scene.name, made.scene.points, instance, other)


def known_instances(scene: Scene) -> Tensor:
    """The instances [N] of a labelled scene's points."""
    assert scene.truth is not None
    assert scene.truth.points is not None
    return scene.truth.points.long()


def judge(labels: Tensor, sweep: Sweep) -> Score:
    """Scores the labels [N] of a scan; a point with -1 is in no segment."""
    return partial_truth.judge(labels, PartialTruth(sweep.instance, sweep.other))


def run(method: Callable[[Tensor], Tensor], sweep: Sweep) -> Score:
    """Runs and scores a method on a scan."""
    return judge(method(sweep.points), sweep)


def best_simple(sweeps: list[Sweep], count: int) -> tuple[list[Score], dict[str, Any]]:
    """Plane removal and DBSCAN at the best of `count` random settings for these very scans; (F + best IoU) / 2."""
    random = np.random.default_rng(0)
    space = spaces.RANSAC_DBSCAN["kitti"]
    best: tuple[float, list[Score], dict[str, Any]] = (-1, [], {})
    for _ in range(count):
        setting = draw(space, random)
        scores = [run(partial(planes_and_clusters, **setting), sweep) for sweep in sweeps]
        quality = fmean(score.f + score.best_iou for score in scores)
        best = max(best, (quality, scores, dict(setting)), key=lambda found: found[0])
    return best[1], best[2]
