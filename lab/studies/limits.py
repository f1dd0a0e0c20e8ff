"""Where is a thing lost: in the superpoints, in the tree, or in the choice of the level? Its best IoU in each, by its
size.

    python lab/studies/limits.py [--data FOLDER] [--kinds room kitchen ycb] [--scenes 4] [--runs 4] [--write]

Superpoints: each superpoint belongs to the thing that has most of its points, so no merging is better. Tree: the best
segment of any of LEVELS levels, another one for each thing. Default: the best segment of the default level. The points
of each run are moved by 0.1 mm. The scenes are those of `torchjoint-lab robustness`; no model was trained on them.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import report
import torch
from torch import Tensor
from torchjoint_lab.benchmark.disturbances import moved
from torchjoint_lab.benchmark.robustness import NOISE
from torchjoint_lab.benchmark.robustness_scenes import GENERATED, KINDS, find_scenes

import torchjoint as tj
from torchjoint.metrics.overlaps import Overlaps
from torchjoint.runtime.groups import most_frequent

#: Number of levels of the tree that are looked at.
LEVELS = 100
#: Points of a thing: limits of the rows.
SIZES = (0, 100, 1000, 10**9)


def best_ious(labels: Tensor, truth: Tensor) -> Tensor:
    """The best IoU of each true thing, [T]; points of no thing, -1, do not count."""
    known = truth >= 0
    segment, thing = labels[known].unique(return_inverse=True)[1], truth[known].unique(return_inverse=True)[1]
    table = Overlaps(segment, int(segment.max()) + 1, thing)
    iou = table.count / (table.pred_area[table.pred] + table.target_area[table.target] - table.count).double()
    return iou.new_zeros(len(table.target_area)).scatter_reduce(0, table.target, iou, "amax")


def of_scene(scene: tj.Scene) -> tuple[Tensor, Tensor]:
    """[3, T] the best IoU of each thing in superpoints, the tree and the default level; [T] its number of points."""
    assert scene.truth is not None
    assert scene.truth.points is not None
    truth, tree = scene.truth.points.long(), tj.JointSegmenter()(scene).hierarchy
    assert tree is not None
    known = truth >= 0
    width = int(truth.max()) + 1
    key, count = torch.unique(tree.superpoint[known] * width + truth[known], return_counts=True)
    superpoint, place = (key // width).unique(return_inverse=True)  # others have no known point
    owner = torch.zeros(tree.num_superpoints, dtype=torch.long)
    owner[superpoint] = most_frequent(key % width, place, count)
    heights = torch.quantile(tree.heights, torch.linspace(0, 1, LEVELS - 1, dtype=torch.float64)).tolist()
    of_tree = torch.stack([best_ious(tree.cut(height), truth) for height in {*heights, tree.default}]).amax(0)
    found = torch.stack([best_ious(owner[tree.superpoint], truth), of_tree, best_ious(tree.at(), truth)])
    return found, torch.bincount(truth[known].unique(return_inverse=True)[1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, help="folder with mosd/ and ycb/")
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=GENERATED)
    parser.add_argument("--scenes", type=int, default=4)
    parser.add_argument("--runs", type=int, default=4)
    report.add_write(parser)
    arguments = parser.parse_args()
    found = defaultdict(list)
    for named in find_scenes(tuple(arguments.kinds), arguments.scenes, arguments.data):
        scene = named.load()
        for run in range(arguments.runs):
            points = moved(scene.points, NOISE, torch.Generator().manual_seed(run))
            found[named.kind].append(of_scene(replace(scene, points=points)))
        print(named.name, [round(float(value), 3) for value in found[named.kind][-1][0].mean(1)], flush=True)
    rows = []
    for kind, scenes in found.items():
        values, size = torch.cat([one for one, _ in scenes], 1), torch.cat([count for _, count in scenes])
        for low, high in pairwise(SIZES):
            chosen = values[:, (size >= low) & (size < high)]
            cells = [f"{value:.3f}" for value in chosen.mean(1).tolist()] if chosen.numel() else ["–"] * 3
            title = f"{low:,} to {high - 1:,}" if high < SIZES[-1] else f"{low:,} and more"
            rows.append([f"{kind}, {title} points", str(chosen.shape[1] // arguments.runs), *cells])
    mean = np.mean([one.mean(1).numpy() for scenes in found.values() for one, _ in scenes], 0)
    rows.append(["all, mean of scenes", "", *(f"{value:.3f}" for value in mean)])
    columns = ["things", "number", "best of the superpoints", "best of the tree", "default level"]
    report.show("limits", report.table(columns, rows), arguments.write)


if __name__ == "__main__":
    main()
