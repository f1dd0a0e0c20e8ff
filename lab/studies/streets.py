"""Labelled LiDAR scans, and how they are scored; used by sensors.py and street_images.py.

In a full annotation, and on generated streets, the points are of three kinds: things and ground are instances; void
points do not count; all others (houses, hedges) are no instances, but they count where a segment mixes them with one.
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
from torchjoint_lab.synthetic import make_domain_scene

from torchjoint.datasets import list_scenes, load_scene
from torchjoint.metrics.objects_and_parts import objects_and_parts_of
from torchjoint.metrics.overlaps import Overlaps
from torchjoint.scene import Scene
from torchjoint.views.projection import in_any_view

#: Seeds of generated streets on which settings may be chosen, and of those that check them.
SEEDS = {"develop": range(10), "check": range(10, 20)}


class Sweep(NamedTuple):
    """One labelled LiDAR scan."""

    name: str
    points: Tensor  #: [N, 3] metres
    instance: Tensor  #: [N] int64, -1 = none
    other: Tensor  #: [N] bool, points of no instance that count where they leak into one


class Score(NamedTuple):
    """One row of the table."""

    f: float
    best_iou: float
    found: float  #: share of the instances with an IoU of more than .5


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
    none = labels < 0
    labels = torch.where(none, int(labels.max()) + 1 + none.cumsum(0), labels)
    counts = (sweep.instance >= 0) | sweep.other
    region = labels[counts].unique(return_inverse=True)[1]
    instance = sweep.instance[counts]
    known = instance >= 0
    num_regions = int(region.max()) + 1
    table = Overlaps(region[known], num_regions, instance[known])
    # What leaks into a region is of no instance, but belongs to the region's size.
    table.pred_area = torch.bincount(region, minlength=num_regions)
    table.precision = table.count.double() / table.pred_area[table.pred]
    iou = table.count / (table.pred_area[table.pred] + table.target_area[table.target] - table.count).double()
    is_none = torch.zeros(num_regions, dtype=torch.bool)
    is_none[region[none[counts]]] = True
    iou[is_none[table.pred]] = 0
    best = iou.new_zeros(len(table.target_area)).scatter_reduce(0, table.target, iou, "amax")
    # Regions of houses and hedges are not judged, unless they hold most of an instance.
    of_instances = torch.bincount(region[known], minlength=num_regions)
    judged = 2 * of_instances >= table.pred_area
    judged[table.pred[table.recall >= 0.5]] = True
    judged &= ~is_none
    f = objects_and_parts_of(torch.where(judged, table.pred_area, 0), [table]).f
    return Score(f, best.mean().item(), (best > 0.5).double().mean().item())


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
