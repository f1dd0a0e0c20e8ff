"""What do the steps of step 6 of the default bring? The default without one of them, on the same evidence.

    python lab/studies/steps.py WORK [--data FOLDER] [--scenes COUNT] [--runs COUNT] [--kinds KIND ...] [--write]

The scenes are those of `torchjoint-lab robustness`; no model was trained on them. In each run the points are moved by
0.1 mm. Scores are kept in WORK, so several processes can share the work: each takes other kinds.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import report
import torch
from domain_tables import difference
from torchjoint_lab.benchmark.disturbances import moved
from torchjoint_lab.benchmark.robustness import BATCH, NOISE
from torchjoint_lab.benchmark.robustness_scenes import GENERATED, KINDS, NamedScene, find_scenes
from torchjoint_lab.evaluation.scores import score

import torchjoint as tj
from torchjoint.runtime.files import write_text
from torchjoint.runtime.threads import one_thread_per_operation
from torchjoint.scene import Hierarchy
from torchjoint.segments.learned import consensus, method, superpoints
from torchjoint.segments.learned.agglomeration import judge_of, merge_superpoints, merging_steps
from torchjoint.segments.learned.method import segment
from torchjoint.segments.learned.superpoint_graph import SuperpointGraph
from torchjoint.views.evidence import Evidence
from torchjoint.views.observations import Observations


def one_tree(copies: Sequence[SuperpointGraph], model: Any) -> Hierarchy:
    return merge_superpoints(copies[0], merging_steps(model.thresholds), judge_of(model))


def nothing_joined(*of: Any) -> None:
    """Instead of what finds surfaces that something nearer cuts in two."""


def no_colors(num_points: int, observations: Observations) -> None:
    """Instead of the colours of images."""


CAMERAS = "cameras, without what images show"
COLORLESS = ("colours of the images, not of the cloud", "no colours")
#: What replaces what: module, name, other value. Those in COLORLESS also take the colours of the cloud away.
STEPS: dict[str, tuple[tuple[Any, str, Any], ...]] = {
    "default": (),
    "one copy of the surface, not three": ((method, "COPIES", 1),),
    "one tree, not fifteen": ((method, "build_consensus", one_tree),),
    "judges without noise": ((consensus, "NOISE", 0.0),),
    "surfaces behind nearer things not joined": ((superpoints, "find_occlusions", nothing_joined),),
    CAMERAS: (),
    COLORLESS[0]: (),
    COLORLESS[1]: ((superpoints, "image_colors", no_colors),),
}
Scores = dict[str, tuple[float, float]]


@torch.no_grad()
def scores(named: NamedScene, run: int) -> Scores:
    """F and best IoU in 3D of the default, and without each of the steps."""
    scene = named.load()
    segmenter = tj.JointSegmenter()
    points = moved(scene.points, NOISE, torch.Generator().manual_seed(run))
    segmenter.reset(points, scene.colors, scene.normals)
    for start in range(0, len(scene.frames), BATCH):
        segmenter.update([scene.frames[i] for i in range(start, min(start + BATCH, len(scene.frames)))])
    assert scene.truth is not None
    blind = replace(Evidence.empty(segmenter.graph), facing=segmenter.state.facing)
    found: Scores = {}
    for name, replaced in STEPS.items():
        graph = replace(segmenter.graph, colors=None) if name in COLORLESS else segmenter.graph
        state = blind if name == CAMERAS else segmenter.state
        with ExitStack() as patches, one_thread_per_operation():
            for module, attribute, value in replaced:
                patches.enter_context(patch.object(module, attribute, value))
            labels = segment(graph, state, segmenter.config).at()[graph.of_given]
        judged = score(labels, scene.truth.points)
        found[name] = (judged.f, judged.best_iou)
    return found


def table(found: dict[str, list[list[Scores]]]) -> str:
    """`found`: for each kind and scene the scores of its runs."""
    groups: dict[str, Callable[[str], bool]] = {
        "generated": lambda kind: kind in GENERATED,
        "real table-tops (mOSD)": lambda kind: kind == "mosd",
        "real desk (YCB-Video)": lambda kind: kind == "ycb",
        "all": lambda kind: True,
    }
    # [scenes, steps, F and best IoU], means over the runs
    values = {
        title: np.array(
            [
                np.mean([[run[step] for step in STEPS] for run in runs], 0)
                for kind, scenes in found.items()
                if belongs(kind)
                for runs in scenes
            ]
        )
        for title, belongs in groups.items()
    }
    values = {title: of_group for title, of_group in values.items() if len(of_group)}
    rows = [["default", *(" / ".join(f"{value:.3f}" for value in one[:, 0].mean(0)) for one in values.values())]]
    for place, step in enumerate(STEPS):
        if place:
            rows.append([step, *(difference(one[:, place] - one[:, 0]) for one in values.values())])
    return report.table(["", *(f"{title}, {len(one)}" for title, one in values.items())], rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("work", type=Path)
    parser.add_argument("--data", type=Path, help="folder with mosd/ and ycb/")
    parser.add_argument("--scenes", type=int, default=2, help="at most so many of each kind")
    parser.add_argument("--runs", type=int, default=4)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=(*GENERATED, "ycb", "mosd"))
    report.add_write(parser)
    arguments = parser.parse_args()
    arguments.work.mkdir(parents=True, exist_ok=True)
    found: dict[str, list[list[Scores]]] = {}
    for named in find_scenes(tuple(arguments.kinds), arguments.scenes, arguments.data):
        runs = []
        for run in range(arguments.runs):
            path = arguments.work / f"{named.name}.{run}.json"
            if not path.is_file():
                write_text(path, json.dumps(scores(named, run)))
                print(path.stem, path.read_text(), flush=True)
            runs.append(json.loads(path.read_text()))
        found.setdefault(named.kind, []).append(runs)
    report.show("steps", table(found), arguments.write)


if __name__ == "__main__":
    main()
