"""Measures whether an image can split or join what a LiDAR scan leaves undecided: method scan, its weights changed.

`python lab/studies/street_images.py --data FOLDER --write`, FOLDER with `kitti/` and `vod/`; also on twenty generated
streets, one image each, and there with masks of three levels of error. Each row changes the weights of edges whose two
ends the image sees, and shows the mean difference to method scan without images, with its standard error over the
scans. Each scan has --runs runs, on points that are moved by 1 cm, and with other errors of the masks.
"""

import argparse
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import report
import sensors
import streets
import torch
from torch import Tensor
from torchjoint_lab.benchmark.disturbances import moved
from torchjoint_lab.synthetic import MASK_LEVELS, make_domain_scene, with_network_masks
from tqdm import tqdm

from torchjoint import ops
from torchjoint.cloud.graph import undirected_edges
from torchjoint.config import Config, ScanConfig
from torchjoint.datasets import list_scenes, load_scene
from torchjoint.joint import JointSegmenter
from torchjoint.runtime.threads import one_thread_per_operation
from torchjoint.scene import Frame, Scene
from torchjoint.segments.scan.gaps import JOINING_GAP, NEIGHBORS
from torchjoint.segments.scan.method import scan_gaps
from torchjoint.views.visibility import in_any_view

#: Number of places along the line between two points at which the boundary is looked at.
SAMPLES = 9


class Scan(NamedTuple):
    """A scan and the image of its camera."""

    sweep: streets.Sweep
    frame: Frame
    scene: Scene | None = None  #: with a true image, of which masks can be made


class Edges(NamedTuple):
    """The edges of a scan, as an image sees them."""

    weight: Tensor  #: [E] method scan's
    same: Tensor  #: [E] bool, both ends in one image segment
    differ: Tensor  #: [E] bool, the ends in two image segments
    boundary: Tensor  #: [E] strongest boundary between the ends, in [0, 1]


Change = Callable[[Edges], Tensor]
Pair = tuple[float, float]
#: What the package's own segments and boundaries of an image may do, and what masks of a network may.
OF_SEGMENTS: dict[str, Change] = {
    "two image segments: weight x 1.5": lambda e: torch.where(e.differ, 1.5 * e.weight, e.weight),
    "two image segments: weight x 4": lambda e: torch.where(e.differ, 4 * e.weight, e.weight),
    "boundary > .05: weight x 2": lambda e: torch.where(e.boundary > 0.05, 2 * e.weight, e.weight),
    "boundary > .1: weight x 2": lambda e: torch.where(e.boundary > 0.1, 2 * e.weight, e.weight),
    "one image segment: weight x .7": lambda e: torch.where(e.same, 0.7 * e.weight, e.weight),
    "one: x .7, two: x 1.5": lambda e: torch.where(
        e.same, 0.7 * e.weight, torch.where(e.differ, 1.5 * e.weight, e.weight)
    ),
}
OF_MASKS: dict[str, Change] = {
    "two masks: weight x 2": lambda e: torch.where(e.differ, 2 * e.weight, e.weight),
    "two masks: never together": lambda e: torch.where(e.differ, torch.inf, e.weight),
    "one mask: weight x .7": lambda e: torch.where(e.same, 0.7 * e.weight, e.weight),
    "one: x .7, two: never": lambda e: torch.where(e.same, 0.7 * e.weight, torch.where(e.differ, torch.inf, e.weight)),
}


def kitti(data: Path) -> Iterator[Scan]:
    frames = (load_scene(path).frames[0] for path in list_scenes(data / "kitti" / "training").values())
    for sweep, frame in zip(streets.kitti(data), frames, strict=True):
        yield Scan(sweep, frame)


def view_of_delft(data: Path) -> Iterator[Scan]:
    """Its truth has -2 for clutter, which a plain folder refuses: so the frame is read as one without truth."""
    (sweep,) = sensors.plain("vod", data)
    with tempfile.TemporaryDirectory() as folder:
        for path in (data / "vod").glob("[!.]*"):
            if not path.name.endswith(".truth.npy"):
                (Path(folder) / path.name).symlink_to(path.resolve())
        frame = load_scene(folder).frames[0]
        yield Scan(sweep, replace(frame, image=frame.image))


def generated() -> Iterator[Scan]:
    for half in streets.SEEDS:
        for seed, sweep in zip(streets.SEEDS[half], streets.streets(half), strict=True):
            scene = make_domain_scene("street", seed, num_views=1).scene
            seen = in_any_view(sweep.points, scene.frames)
            sweep = sweep._replace(points=sweep.points[seen], instance=sweep.instance[seen], other=sweep.other[seen])
            yield Scan(sweep, scene.frames[0], scene)


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
        gaps, on_ground, _ = scan_gaps(points, config, "search")
        u, v = undirected_edges(ops.nearest_neighbors(gaps.points, NEIGHBORS, 0)[0])  # also those beyond a gap
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


def differences(scan: Scan, frame: Frame, changes: dict[str, Change], config: Config, seed: int) -> list[Pair]:
    """F and best IoU without images, and the differences of all changes."""
    points = moved(scan.sweep.points, sensors.NOISE, torch.Generator().manual_seed(seed))
    sweep = scan.sweep._replace(points=points)
    edges, weight, on_ground = scan_graph(sweep.points, config.scan)
    seen = seen_edges(sweep.points, frame, edges, weight, config)

    def score(weights: Tensor) -> streets.Score:
        return streets.judge(components(edges, weights, on_ground, config.scan), sweep)

    plain = score(weight)
    changed = [score(change(seen)) for change in changes.values()]
    return [(plain.f, plain.best_iou), *((one.f - plain.f, one.best_iou - plain.best_iou) for one in changed)]


def column(scans: list[Scan], level: str | None, runs: int, config: Config) -> list[str]:
    """The method without images, and the changes by masks of a level of error; None: by the image's own segments."""
    changes = OF_SEGMENTS if level is None else OF_MASKS

    def frame_of(scan: Scan, seed: int) -> Frame:
        if level is None:
            return scan.frame
        assert scan.scene is not None
        return with_network_masks(scan.scene, level, seed).frames[0]

    found = torch.tensor(
        [
            [differences(scan, frame_of(scan, seed), changes, config, seed) for seed in range(runs)]
            for scan in tqdm(scans, unit="scan")
        ]
    ).mean(1)  # [scans, rows, 2]
    error = found.std(0) / len(scans) ** 0.5
    plain, *rest = zip(found.mean(0).tolist(), error.tolist(), strict=True)
    changed = (" / ".join(f"{m:+.3f} ± {e:.3f}" for m, e in zip(*both, strict=True)) for both in rest)
    return [" / ".join(f"{mean:.3f}" for mean in plain[0]), *changed]


def table(columns: dict[str, list[str]], changes: dict[str, Change]) -> str:
    return report.table(
        ["", *columns], [list(row) for row in zip(["method scan", *changes], *columns.values(), strict=True)]
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="folder with kitti/ and vod/")
    parser.add_argument("--runs", type=int, default=4, help="runs of each scan")
    parser.add_argument("--scans", type=int, metavar="COUNT", help="at most so many of each kind")
    report.add_write(parser, "the tables in lab/studies/README.md")
    arguments = parser.parse_args()
    config = Config.from_preset("scan")
    real = [*kitti(arguments.data), *view_of_delft(arguments.data)][: arguments.scans]
    made = list(islice(generated(), arguments.scans))
    settings = arguments.runs, config
    segments = {
        f"{len(real)} real scans": column(real, None, *settings),
        f"{len(made)} generated streets": column(made, None, *settings),
    }
    masks = {f"streets, masks {level}": column(made, level, *settings) for level in MASK_LEVELS}
    text = f"{table(segments, OF_SEGMENTS)}\n\n{table(masks, OF_MASKS)}"
    report.show("street images", text, arguments.write)


if __name__ == "__main__":
    main()
