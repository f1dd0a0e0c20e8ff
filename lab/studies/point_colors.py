"""What are colours of the images worth to a cloud without colours? With models that never saw the kind of data.

    python lab/studies/point_colors.py WORK RESULTS --data DATA [--models FOLDER] [--seeds FIRST END] [--frames N]
        [--kinds KIND ...] [--write]

WORK is the folder of lab/studies/domains.py after `--part left-out`, DATA holds mosd/ and ycb/. Each scene's scores are
kept in the folder RESULTS, so several processes can share the work: each takes other kinds or seeds. The table has all
scenes in RESULTS.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from unittest.mock import patch

import numpy as np
import report
import torch
from domain_tables import difference
from domains import DOMAINS, Named, make_scene, scenes
from members import left_out_models
from torchjoint_lab.training.boundary_examples import learned_config

import torchjoint as tj
from torchjoint.evaluation.scores import score
from torchjoint.runtime.files import write_text
from torchjoint.runtime.threads import one_thread_per_operation
from torchjoint.scene import Scene
from torchjoint.segments.learned import pieces as evidence_of_points
from torchjoint.segments.learned.boundary_model import BoundaryModel
from torchjoint.segments.learned.consensus import build_consensus
from torchjoint.segments.learned.image_colors import image_colors
from torchjoint.segments.learned.pieces import build_piece_graph

#: Kinds of data, and the kind whose left-out models never saw them.
KINDS = {"mosd": "mosd", "ycb": "desk", **{kind: kind for kind in DOMAINS}}
NAMES = {"mosd": "real table-tops (mOSD)", "ycb": "real desk (YCB-Video)"}
#: Frames held in memory at a time.
FRAMES = 4


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("work", type=Path)
    parser.add_argument("results", type=Path)
    parser.add_argument("--data", type=Path, required=True, help="folder with mosd/ and ycb/")
    parser.add_argument("--models", type=Path, help="folder of 3D models for the generated scenes")
    parser.add_argument("--seeds", type=int, nargs=2, default=(120, 136), help="of the generated scenes")
    parser.add_argument("--scenes", type=int, metavar="COUNT", help="at most so many of each kind of real data")
    parser.add_argument("--frames", type=int, help="only the first ones of each scene")
    parser.add_argument("--kinds", nargs="+", choices=list(KINDS), default=list(KINDS))
    report.add_write(parser)
    arguments = parser.parse_args()
    arguments.results.mkdir(parents=True, exist_ok=True)
    for kind in arguments.kinds:
        model = left_out_models(arguments.work, KINDS[kind])
        for name, load in scenes_of(kind, arguments):
            done = arguments.results / f"{name}.json"
            if not done.is_file():
                write_text(done, json.dumps(scores(load(), model, arguments.frames)))
                print(name, json.loads(done.read_text()), flush=True)
    report.show("point colours", table(arguments.results), arguments.write)


def scenes_of(kind: str, arguments: argparse.Namespace) -> Iterator[Named]:
    if kind not in DOMAINS:
        yield from scenes(kind, "scoring", arguments)
        return
    for seed in range(*arguments.seeds):
        yield Named(f"{kind}-{seed}", partial(make_scene, kind, seed, arguments.models, True))


@torch.no_grad()
def scores(scene: Scene, model: BoundaryModel, num_frames: int | None) -> list[tuple[float, float]]:
    """F and best IoU with no colours, with those of the images, and with the cloud's own."""
    segmenter = tj.JointSegmenter(learned_config())
    segmenter.reset(scene.points, scene.colors, scene.normals)
    frames = scene.frames[:num_frames]
    for start in range(0, len(frames), FRAMES):
        segmenter.update([frames[i] for i in range(start, min(start + FRAMES, len(frames)))])
    graph, state = segmenter.cloud.graph, segmenter.state
    assert graph.scales is not None
    assert scene.truth is not None
    assert scene.truth.points is not None
    found = []
    for given in (None, image_colors(graph.num_points, state.observations), graph.colors):
        with one_thread_per_operation(), patch.object(evidence_of_points, "image_colors", return_value=None):
            evidence = build_piece_graph(replace(graph, colors=given), graph.scales, state)
            labels = build_consensus([evidence], model).at()
        judged = score(labels[segmenter.cloud.of_point], scene.truth.points)
        found.append((judged.f, judged.best_iou))
    return found


def table(results: Path) -> str:
    """The scores of all scenes in the folder."""
    of_kind: dict[str, list[list[tuple[float, float]]]] = {kind: [] for kind in KINDS}
    for path in sorted(results.glob("*.json")):
        of_kind[path.stem.split("-")[0]].append(json.loads(path.read_text()))
    values = {kind: np.array(rows) for kind, rows in of_kind.items() if rows}  # [scenes, ways, F and best IoU]
    values["all"] = np.concatenate(list(values.values()))
    rows = []
    for kind, found in values.items():
        cells = [" / ".join(f"{value:.3f}" for value in mean) for mean in found.mean(0)]
        rows.append([f"{NAMES.get(kind, kind)}, {len(found)}", *cells, difference(found[:, 1] - found[:, 0])])
    columns = ["scenes", "no colours", "the images' colours", "the cloud's own", "the images' - none"]
    return report.table(columns, rows)


if __name__ == "__main__":
    main()
