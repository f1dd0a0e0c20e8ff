"""Live segmentation on generated scenes: scores with noise in the poses, and how long things keep their ids.

    python lab/studies/live.py WORK [--kinds room kitchen desk] [--scenes 1] [--views 12] [--runs 4] [--write]

Each scene is seen frame by frame, with a result after every third. The poses have noise of 0, 5 and 10 % of the way and
the turn between two frames, as in the evaluation of ESAM++; each run has noise of its own, and points that are moved by
.1 mm by that of the depth. F and best IoU are those of the last result against the truth of the nearest true points. An
id lasts if the thing has had it in all results since 90 % of its cubes of 10 cm were seen. In a second table the camera
moves by small steps: the last result is compared with that of all frames as keyframes, and ids, with a result after
every tenth frame, count from 30 frames after the thing was whole. WORK keeps what is done.
"""

from __future__ import annotations

import argparse
import json
import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import report
import torch
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from torch import Generator, Tensor
from torchjoint_lab.evaluation.scores import score
from torchjoint_lab.synthetic import make_domain_scene

import torchjoint as tj
from torchjoint.runtime.files import write_text
from torchjoint.scene.frame import camera_center

KINDS = ("room", "kitchen", "desk")
#: Seeds of scenes that are in no training.
SEEDS = (40, 41, 42, 43)
NOISES = (0.0, 0.05, 0.1)
#: A result after so many frames; metres a cube's side; share of a thing's cubes that makes it whole.
EVERY, CUBE, WHOLE = 3, 0.1, 0.9
#: In the second table, a result after so many frames; an id counts from this many frames after its thing was whole.
EVERY_DENSE, SETTLED = 10, 30
VOXEL = 0.03
#: Metres; fused points farther from any point of the truth do not count.
NEAR = 0.05


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("work", type=Path)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS)
    parser.add_argument("--scenes", type=int, default=1, help="of each kind, at most 4")
    parser.add_argument("--views", type=int, default=12)
    parser.add_argument("--dense", type=int, default=200, help="views of the second table")
    parser.add_argument("--runs", type=int, default=4)
    report.add_write(parser)
    arguments = parser.parse_args()
    arguments.work.mkdir(parents=True, exist_ok=True)
    rows = []
    for kind in arguments.kinds:
        found = np.array([measured(kind, seed, arguments) for seed in SEEDS[: arguments.scenes]])
        means = found.mean(0)  # [noises, runs, scores]
        for noise, of_runs in zip(NOISES, means, strict=True):
            cells = [_cell(values) for values in of_runs.T]
            rows.append([f"{kind}, {len(found)}", f"{noise:.0%}", f"{cells[0]} / {cells[1]}", cells[2], cells[3]])
    columns = ["kind, scenes", "noise of poses", "F / best IoU", "things whose id lasts", "points in them"]
    report.show("live", report.table(columns, rows), arguments.write)
    rows = []
    for kind in arguments.kinds:
        found = np.array([compared(kind, seed, arguments) for seed in SEEDS[: arguments.scenes]])
        means = [_cell(values) for values in found.mean(0).T]
        last = np.array([settled(kind, seed, arguments) for seed in SEEDS[: arguments.scenes]])
        means += [_cell(values) for values in last.mean(0).T]
        rows.append([f"{kind}, {len(found)}", f"{found[..., 0].mean():.0f}", *_pairs(means[1:5]), *means[5:]])
    columns = ["kind, scenes", f"keyframes of {arguments.dense}", "F / best IoU", "with all frames", "covering"]
    columns += ["things whose id lasts", "points in them", "things with it at the end"]
    report.show("keyframes", report.table(columns, rows), arguments.write)


def _cell(values: Sequence[float]) -> str:
    spread = f" ± {np.std(values, ddof=1):.3f}" if len(values) > 1 else ""
    return f"{np.mean(values):.3f}{spread}"


def _pairs(cells: Sequence[str]) -> list[str]:
    return [" / ".join(cells[at : at + 2]) for at in range(0, len(cells), 2)]


def compared(kind: str, seed: int, arguments: argparse.Namespace) -> list[list[float]]:
    """For each run: the number of keyframes; F and best IoU with those, and with all frames; and their covering."""

    def measure(scene: tj.Scene, frames: Sequence[tj.Frame]) -> list[float]:
        some = tj.LiveSegmenter(voxel_size=VOXEL)
        every = tj.LiveSegmenter(voxel_size=VOXEL, step=0, turn=0, views=0)
        some.update(frames)
        every.update(frames)
        found, best = some.result(images=False), every.result(images=False)
        covering = tj.metrics.segmentation_covering(found.labels, best.labels).symmetric
        return [len(some.names), *against(scene, found), *against(scene, best), covering]

    return of_dense_runs("dense", measure, kind, seed, arguments)


def settled(kind: str, seed: int, arguments: argparse.Namespace) -> list[list[float]]:
    """For each run what :func:`lasting` gives, once things are settled."""

    def measure(_: tj.Scene, frames: Sequence[tj.Frame]) -> list[float]:
        return list(lasting(results_of(frames, EVERY_DENSE), SETTLED // EVERY_DENSE))

    return of_dense_runs("ids", measure, kind, seed, arguments)


def of_dense_runs(
    name: str,
    measure: Callable[[tj.Scene, Sequence[tj.Frame]], list[float]],
    kind: str,
    seed: int,
    arguments: argparse.Namespace,
) -> list[list[float]]:
    """What `measure` says of each run of a scene with many frames; what is in WORK is not measured again."""
    scene, runs = None, []
    for run in range(arguments.runs):
        done = arguments.work / f"{kind}-{seed}-{arguments.dense}-{name}-{run}.json"
        if not done.is_file():
            scene = scene or make_domain_scene(kind, seed, num_views=arguments.dense, held_out=True).scene
            write_text(done, json.dumps(measure(scene, disturbed(scene.frames, 0.0, Generator().manual_seed(run)))))
            print(done.stem, done.read_text(), flush=True)
        runs.append(json.loads(done.read_text()))
    return runs


def results_of(frames: Sequence[tj.Frame], every: int) -> list[tj.LiveResult]:
    """The results after `every` frames, and after the last one."""
    segmenter, results = tj.LiveSegmenter(voxel_size=VOXEL), []
    for count, frame in enumerate(frames, start=1):
        segmenter.update(frame)
        if count % every == 0 or count == len(frames):
            results.append(segmenter.result(images=False))
    return results


def against(scene: tj.Scene, result: tj.LiveResult) -> tuple[float, float]:
    """F and best IoU against the truth of the nearest true points."""
    assert scene.truth is not None
    assert scene.truth.points is not None
    away, nearest = map(torch.from_numpy, cKDTree(scene.points.numpy()).query(result.cloud.points.numpy()))
    judged = score(result.segmentation.points, torch.where(away < NEAR, scene.truth.points[nearest].long(), -1))
    return judged.f, judged.best_iou


def measured(kind: str, seed: int, arguments: argparse.Namespace) -> list[list[list[float]]]:
    """The scores of a scene for each of NOISES and each run."""
    scene = None
    of_noises: list[list[list[float]]] = []
    for noise in NOISES:
        of_noises.append(of_runs := [])
        for run in range(arguments.runs):
            done = arguments.work / f"{kind}-{seed}-{arguments.views}-{noise}-{run}.json"
            if not done.is_file():
                scene = scene or make_domain_scene(kind, seed, num_views=arguments.views, held_out=True).scene
                write_text(done, json.dumps(judged(scene, noise, run)))
                print(done.stem, done.read_text(), flush=True)
            of_runs.append(json.loads(done.read_text()))
    return of_noises


def judged(scene: tj.Scene, noise: float, run: int) -> list[float]:
    """F, best IoU, the share of things whose id lasts, and that of the points in them."""
    frames = disturbed(scene.frames, noise, Generator().manual_seed(run))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        results = results_of(frames, EVERY)
    return [*against(scene, results[-1]), *lasting(results)[:2]]


def disturbed(frames: Sequence[tj.Frame], noise: float, random: Generator) -> list[tj.Frame]:
    """Frames with noise in their poses: a share of the way and the turn from the frame before; moved by .1 mm."""
    found = []
    for index in range(len(frames)):
        frame, before = frames[index], frames[max(index - 1, 0)]
        way = float((camera_center(frame.world_to_camera) - camera_center(before.world_to_camera)).norm())
        turn = (frame.world_to_camera @ torch.linalg.inv(before.world_to_camera))[:3, :3]
        angle = math.acos(max(-1.0, min(1.0, (float(turn.trace()) - 1) / 2)))
        error = torch.eye(4, dtype=torch.float64)
        axis = torch.randn(3, generator=random, dtype=torch.float64)
        error[:3, :3] = torch.from_numpy(Rotation.from_rotvec((noise * angle * axis / 3**0.5).numpy()).as_matrix())
        error[:3, 3] = noise * way * torch.randn(3, generator=random, dtype=torch.float64) / 3**0.5
        depth = frame.depth
        assert depth is not None
        shaken = depth + (depth > 0) * 1e-4 * torch.randn(depth.shape, generator=random)
        found.append(replace(frame, world_to_camera=error @ frame.world_to_camera, depth=shaken.clamp(min=0)))
    return found


def lasting(results: Sequence[tj.LiveResult], settling: int = 0) -> tuple[float, float, float]:
    """The share of the last things that have kept their id since they were whole; that of the points in them.

    And the share of those that had their last id in the first result that counts. The first results after they were
    whole, `settling`, do not count; nor do things that were whole in no more.
    """
    cubes = [cubes_of(result) for result in results]
    last, kept, at_end, size = cubes[-1], [], [], []
    for thing in sorted(set(last.values())):
        own = [cube for cube, label in last.items() if label == thing]
        seen = [[before[cube] for cube in own if cube in before] for before in cubes]
        whole = [labels for labels in seen if len(labels) >= WHOLE * len(own)]
        if len(whole) > settling:
            has_it = [2 * labels.count(thing) > len(labels) for labels in whole[settling:]]
            kept.append(all(has_it))
            at_end.append(has_it[0])
            size.append(int((results[-1].labels == thing).sum()))
    if not kept:
        return math.nan, math.nan, math.nan
    weight = np.array(size) / sum(size)
    return float(np.mean(kept)), float((weight * np.array(kept)).sum()), float(np.mean(at_end))


def cubes_of(result: tj.LiveResult) -> dict[tuple[int, ...], int]:
    """The id that most points of each cube have."""
    place: Tensor = (result.cloud.points / CUBE).floor().long()
    rows, counts = torch.unique(torch.cat([place, result.labels[:, None]], 1), dim=0, return_counts=True)
    found: dict[tuple[int, ...], int] = {}
    for row in rows[counts.argsort(stable=True)].tolist():  # the most frequent comes last
        found[tuple(row[:3])] = row[3]
    return found


if __name__ == "__main__":
    main()
