"""What the merging by masks costs for many superpoints and many frames: `python benchmarks/mask_cost.py`.

Superpoints stand on a floor, PER_OBJECT neighbours make an object, and a camera walks over the floor. Each frame sees
the superpoints of a disc, whose area is a share of the floor's, and its masks are the objects there, some split in two,
some joined, some missing. So the counts are those of a recording, without its images. Each row is a process of its own:
the size of the counts, the time of the merging in the model's steps, and the largest resident memory above what the
process took before the counts.
"""

import argparse
import json
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import report
import torch
from scipy.spatial import cKDTree

from torchjoint import ops
from torchjoint.ops.internal import WEIGHT_UNIT
from torchjoint.segments.learned.masks import MaskLinkage
from torchjoint.segments.learned.superpoint_graph import MaskCounts

PER_OBJECT, NEIGHBORS, POINTS_PER_SUPERPOINT = 12, 6, 30
SPLIT, JOINED, MISSING = 0.3, 0.08, 0.15
THRESHOLDS = (0.1, 0.3, 0.5)
#: (superpoints, frames, share of the floor that a frame sees)
ROWS = ((1_000, 150, 0.2), (10_000, 150, 0.05), (10_000, 1_500, 0.01), (10_000, 1_500, 0.05), (10_000, 1_500, 0.2))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--one", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.one:
        superpoints, frames, share = arguments.one.split(",")
        print(json.dumps(measure(int(superpoints), int(frames), float(share))))
        return
    rows = []
    for row in ROWS:
        command = [sys.executable, __file__, "--one", ",".join(map(str, row))]
        output = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout
        measured = json.loads(output.splitlines()[-1])
        print(row, measured, flush=True)
        superpoints, frames, share = row
        sizes = [
            f"{superpoints:,}",
            frames,
            f"{share:.0%}",
            measured["rows"] / 1e6,
            measured["far"],
            measured["regions"],
        ]
        rows.append([*sizes, measured["touching"], measured["all pairs"], measured["memory"]])
    columns = {"superpoints": 0, "frames": 0, "seen by a frame": 0, "million counts": 2, "pairs that do not touch": 0}
    columns |= {"regions at the end": 0, "s, touching": 1, "s, all pairs": 1, "GB": 2}
    report.save("mask_cost", [report.Table(columns, rows)])


def measure(num_superpoints: int, num_frames: int, share: float) -> dict[str, float]:
    """Sizes, seconds and memory of one row."""
    random = np.random.default_rng(0)
    place = random.random((num_superpoints, 2))
    of_object = cKDTree(random.random((num_superpoints // PER_OBJECT, 2))).query(place)[1]
    before = memory("VmRSS")
    masks = counts(place, of_object, num_frames, share, random)
    linkage = MaskLinkage(masks, torch.full((num_superpoints,), POINTS_PER_SUPERPOINT))
    near = cKDTree(place).query(place, NEIGHBORS + 1)[1][:, 1:]
    ends = torch.from_numpy(np.stack([np.repeat(np.arange(num_superpoints), NEIGHBORS), near.ravel()]))
    ends = torch.unique(ends.sort(0).values, dim=1)
    cost = torch.from_numpy(random.random(ends.shape[1], dtype=np.float32))

    region, started = torch.arange(num_superpoints), time.perf_counter()
    for threshold in THRESHOLDS:
        region = merged(linkage, region, ends, cost, threshold)
    touching = time.perf_counter() - started
    far = linkage.far_pairs(region)
    region = merged(linkage, region, ends, cost, THRESHOLDS[-1], far)
    seconds = time.perf_counter() - started
    return {
        "rows": masks.in_mask.shape[1] + masks.in_frame.shape[1],
        "far": far.shape[1],
        "regions": int(region.max()) + 1,
        "touching": touching,
        "all pairs": seconds,
        "memory": memory("VmHWM") - before,
    }


def merged(
    linkage: MaskLinkage,
    of_superpoint: torch.Tensor,
    ends: torch.Tensor,
    cost: torch.Tensor,
    threshold: float,
    far: torch.Tensor | None = None,
) -> torch.Tensor:
    """The regions of the superpoints after a step of the merging."""
    between = of_superpoint[ends]
    across = between[0] != between[1]
    between, cost = between[:, across], cost[across]
    if far is not None:
        between = torch.cat([between, far], 1)
        cost = torch.cat([cost, torch.ones(far.shape[1])])
    joined, _ = linkage.merges(of_superpoint, between, cost, torch.ones_like(between[0]), threshold)
    num_regions = int(of_superpoint.max()) + 1
    return ops.connected_components(joined, num_regions)[of_superpoint]


def counts(
    place: np.ndarray, of_object: np.ndarray, num_frames: int, share: float, random: np.random.Generator
) -> MaskCounts:
    """What the frames of a walk over the floor see of the superpoints, and of the objects' masks."""
    tree, radius = cKDTree(place), (share / np.pi) ** 0.5
    walk = np.cumsum(random.normal(0, 0.05, (num_frames, 2)), 0)
    center = 1 - np.abs(np.mod(walk, 2) - 1)  # reflected at the walls
    in_mask, in_frame, frame_of_mask, num_masks = [], [], [], 0
    for frame, seen in enumerate(tree.query_ball_point(center, radius)):
        superpoint = np.sort(np.array(seen, dtype=np.int64))
        if not len(superpoint):
            continue
        objects, mask = np.unique(of_object[superpoint], return_inverse=True)
        joins = random.random(len(objects)) < JOINED
        mask = np.where(joins[mask], np.maximum(mask - 1, 0), mask)
        splits = (random.random(len(objects)) < SPLIT)[mask] & (random.random(len(superpoint)) < 0.5)
        mask = np.unique(mask + len(objects) * splits, return_inverse=True)[1]
        kept = ~(random.random(mask.max() + 1) < MISSING)[mask]
        points = random.integers(POINTS_PER_SUPERPOINT // 4, POINTS_PER_SUPERPOINT, len(superpoint))
        in_frame.append(np.stack([superpoint, np.full(len(superpoint), frame), points]))
        in_mask.append(np.stack([superpoint, num_masks + mask, points])[:, kept])
        frame_of_mask.append(np.full(mask.max() + 1, frame))
        num_masks += mask.max() + 1
    tables = (torch.from_numpy(np.concatenate(rows, 1)) for rows in (in_mask, in_frame))
    frames, bare = torch.from_numpy(np.concatenate(frame_of_mask)), torch.empty(2, 0, dtype=torch.int64)
    return MaskCounts(*tables, torch.full((num_masks,), WEIGHT_UNIT), frames, bare)


def memory(name: str) -> float:
    """VmRSS, resident now, or VmHWM, the largest so far; GB."""
    return int(re.search(rf"{name}:\s*(\d+) kB", Path("/proc/self/status").read_text())[1]) * 1024 / 1e9


if __name__ == "__main__":
    main()
