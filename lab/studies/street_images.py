"""Measures whether an image can split or join what a LiDAR scan leaves undecided: method scan, its weights changed.

`python lab/studies/street_images.py --data FOLDER`, FOLDER with `kitti/`; also on generated streets (the seeds to
develop on), one image each. Each row changes the weights of edges whose two ends the image sees, and shows the mean
difference to method scan without images, with its standard error.
"""

import argparse
from collections.abc import Callable, Iterator
from pathlib import Path
from statistics import fmean, stdev
from typing import NamedTuple

import streets
import torch
from torch import Tensor
from torchjoint_lab.synthetic import make_domain_scene

from torchjoint import ops
from torchjoint.cloud.graph import undirected_edges
from torchjoint.config import Config, ScanConfig
from torchjoint.datasets import list_scenes, load_scene
from torchjoint.joint import JointSegmenter
from torchjoint.runtime.threads import one_thread_per_operation
from torchjoint.scene import Frame
from torchjoint.segments.scan.gaps import JOINING_GAP
from torchjoint.segments.scan.scan_segments import scan_gaps
from torchjoint.views.projection import in_any_view

#: Number of places along the line between two points at which the boundary is looked at.
SAMPLES = 9


class Edges(NamedTuple):
    """The edges of a scan, as an image sees them."""

    weight: Tensor  #: [E] method scan's
    same: Tensor  #: [E] bool, both ends in one image segment
    differ: Tensor  #: [E] bool, the ends in two image segments
    boundary: Tensor  #: [E] strongest boundary between the ends, in [0, 1]


CHANGES: dict[str, Callable[[Edges], Tensor]] = {
    "two image segments: weight x 1.5": lambda e: torch.where(e.differ, 1.5 * e.weight, e.weight),
    "two image segments: weight x 4": lambda e: torch.where(e.differ, 4 * e.weight, e.weight),
    "boundary > .05: weight x 2": lambda e: torch.where(e.boundary > 0.05, 2 * e.weight, e.weight),
    "boundary > .1: weight x 2": lambda e: torch.where(e.boundary > 0.1, 2 * e.weight, e.weight),
    "one image segment: weight x .7": lambda e: torch.where(e.same, 0.7 * e.weight, e.weight),
    "one: x .7, two: x 1.5": lambda e: torch.where(
        e.same, 0.7 * e.weight, torch.where(e.differ, 1.5 * e.weight, e.weight)
    ),
}


def kitti(data: Path) -> Iterator[tuple[streets.Sweep, Frame]]:
    frames = (load_scene(path).frames[0] for path in list_scenes(data / "kitti" / "training").values())
    yield from zip(streets.kitti(data), frames, strict=True)


def generated() -> Iterator[tuple[streets.Sweep, Frame]]:
    for seed, sweep in zip(streets.SEEDS["develop"], streets.streets("develop"), strict=True):
        frame = make_domain_scene("street", seed, num_views=1).scene.frames[0]
        seen = in_any_view(sweep.points, [frame])
        yield (
            sweep._replace(points=sweep.points[seen], instance=sweep.instance[seen], other=sweep.other[seen]),
            frame,
        )


def seen_edges(points: Tensor, frame: Frame, edges: Tensor, weight: Tensor, config: Config) -> Edges:
    """What an image says about edges [2, E]."""
    segmenter = JointSegmenter(config)
    segmenter.reset(points)
    segmenter.update(frame)
    (observation,) = segmenter.state.observations
    visible = observation.visible
    place = torch.full((len(points), 2), -1)
    place[visible.point] = torch.stack([visible.row.long(), visible.column.long()], 1)
    u, v = (place[end] for end in edges)
    both = (u[:, 0] >= 0) & (v[:, 0] >= 0)
    label_u, label_v = (observation.labels[end[:, 0], end[:, 1]] for end in (u.clamp(min=0), v.clamp(min=0)))
    way = torch.linspace(0, 1, SAMPLES)[:, None, None]
    row, column = (u.clamp(min=0) * (1 - way) + v.clamp(min=0) * way).round().long().unbind(2)
    boundary = observation.boundary.float()[row, column].amax(0) / 255
    same = both & (label_u == label_v) & (label_u >= 0)
    differ = both & (label_u != label_v) & (label_u >= 0) & (label_v >= 0)
    return Edges(weight, same, differ, torch.where(both, boundary, 0.0))


def scan_graph(points: Tensor, config: ScanConfig) -> tuple[Tensor, Tensor, Tensor]:
    """Edges [2, E] between points over the ground; their lengths in allowed gaps [E]; [N] bool, True for ground."""
    with one_thread_per_operation():
        gaps, on_ground = scan_gaps(points, config, "search")
        u, v = undirected_edges(gaps.neighbors)
        length = (gaps.points[u].double() - gaps.points[v].double()).norm(dim=1)
        edges, weight = gaps.which[torch.stack([u, v])], (length / torch.minimum(gaps.gap[u], gaps.gap[v])).float()
        above = ~on_ground[edges].any(0)
        return edges[:, above], weight[above], on_ground


def components(edges: Tensor, weight: Tensor, on_ground: Tensor, config: ScanConfig) -> Tensor:
    """Labels [N]: components of edges of at most one gap, and the ground; small components are joined to others.

    Felzenszwalb-Huttenlocher does both with k = 0 and weights max(0, w - 1).
    """
    near = weight <= JOINING_GAP
    of_ground = torch.nonzero(on_ground).flatten()
    chain = torch.stack([of_ground[:-1], of_ground[1:]])
    excess = torch.cat([(weight[near] - 1).clamp(min=0), torch.zeros(chain.shape[1], dtype=torch.float32)])
    return ops.felzenszwalb(torch.cat([edges[:, near], chain], 1), excess, len(on_ground), 0.0, config.min_size)


def differences(sweep: streets.Sweep, frame: Frame, config: Config) -> dict[str, tuple[float, float]]:
    """F and best IoU without images, and the differences of all changes."""
    edges, weight, on_ground = scan_graph(sweep.points, config.scan)
    seen = seen_edges(sweep.points, frame, edges, weight, config)

    def score(weights: Tensor) -> streets.Score:
        return streets.judge(components(edges, weights, on_ground, config.scan), sweep)

    plain, found = score(weight), {}
    for name, change in CHANGES.items():
        changed = score(change(seen))
        found[name] = (changed.f - plain.f, changed.best_iou - plain.best_iou)
    return {"method scan": (plain.f, plain.best_iou), **found}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True, help="folder with kitti/")
    arguments = parser.parse_args()
    config = Config.from_preset("scan")
    for name, scans in (("KITTI", kitti(arguments.data)), ("generated streets", generated())):
        found = [differences(sweep, frame, config) for sweep, frame in scans]
        print(f"\n| {len(found)} scans, {name} | F | best IoU |\n|---|---:|---:|")
        for row in found[0]:
            columns = [[of_scan[row][i] for of_scan in found] for i in (0, 1)]
            error = [stdev(column) / len(column) ** 0.5 for column in columns]
            cells = (
                f"{fmean(c):.3f}" if row == "method scan" else f"{fmean(c):+.3f} ± {e:.3f}"
                for c, e in zip(columns, error, strict=True)
            )
            print(f"| {row} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
