"""What does it bring to join surfaces behind occluders? The default with and without this step, on the same evidence.

    python lab/studies/occlusions.py RESULTS.jsonl [--mosd FOLDER] [--seeds FIRST END] [--write]

Generated scenes with one view and with as many as their settings draw, and mOSD's checking half. Lines of RESULTS are
not computed again.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import report
import torch
from domain_tables import difference
from domains import DOMAINS, load_thinned
from torchjoint_lab.synthetic import make_domain_scene
from torchjoint_lab.training.boundary_examples import learned_config

import torchjoint as tj
from torchjoint.evaluation.scores import score
from torchjoint.runtime.threads import one_thread_per_operation
from torchjoint.scene import Scene
from torchjoint.segments.learned.boundary_model_file import load_boundary_model
from torchjoint.segments.learned.consensus import build_consensus
from torchjoint.segments.learned.pieces import build_piece_graph

#: Frames held in memory at a time.
FRAMES = 4
VIEWS = {"one view": 1, "all views": None}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("results", type=Path)
    parser.add_argument("--mosd", type=Path, help="folder of mOSD's learn half")
    parser.add_argument("--seeds", type=int, nargs=2, default=(34, 42), help="of the generated scenes")
    parser.add_argument("--domains", nargs="+", choices=DOMAINS, default=DOMAINS, help="of the generated scenes")
    report.add_write(parser)
    arguments = parser.parse_args()
    lines = arguments.results.read_text().splitlines() if arguments.results.is_file() else []
    done = {record["scene"]: record for record in map(json.loads, lines)}
    rows: dict[str, list[list[list[float]]]] = {}
    for row, name, load in scenes(arguments):
        if name not in done:
            done[name] = {"scene": name, "scores": scores(load())}
            with arguments.results.open("a") as file:
                file.write(json.dumps(done[name]) + "\n")
        rows.setdefault(row, []).append(done[name]["scores"])
        print(name, done[name]["scores"], flush=True)
    body = []
    for row, of_row in rows.items():
        values = np.array(of_row)  # [scenes, without and with, F and best IoU]
        cells = [" / ".join(f"{value:.3f}" for value in mean) for mean in values.mean(0)]
        changed = int((values[:, 0] != values[:, 1]).any(1).sum())
        body.append([f"{row}, {len(values)}", *cells, difference(values[:, 1] - values[:, 0]), str(changed)])
    columns = ["scenes", "without", "with", "with - without", "scenes that change"]
    report.show("occlusions", report.table(columns, body), arguments.write)


def scenes(arguments: argparse.Namespace) -> Iterator[tuple[str, str, Callable[[], Scene]]]:
    """Row of the table, name, and a function that makes the scene."""
    if arguments.mosd is not None:
        found = tj.datasets.list_scenes(arguments.mosd)
        for name in sorted(found, key=lambda name: (len(name), name))[1::2]:
            yield "real table-tops (mOSD), one view", f"mosd-{name}", partial(load_thinned, found[name], "mosd")
    for text, views in VIEWS.items():
        for domain in arguments.domains:
            for seed in range(*arguments.seeds):
                yield f"generated, {text}", f"{domain}-{seed}-{text}", partial(make_scene, domain, seed, views)


def make_scene(domain: str, seed: int, views: int | None) -> Scene:
    return make_domain_scene(domain, seed, num_views=views).scene


@torch.no_grad()
def scores(scene: Scene) -> list[tuple[float, float]]:
    """F and best IoU in 3D, without and with the step."""
    segmenter = tj.JointSegmenter(learned_config())
    segmenter.reset(scene.points, scene.colors, scene.normals)
    for start in range(0, len(scene.frames), FRAMES):
        segmenter.update([scene.frames[i] for i in range(start, min(start + FRAMES, len(scene.frames)))])
    cloud = segmenter.cloud
    assert cloud.graph.scales is not None
    assert scene.truth is not None
    found = []
    with one_thread_per_operation():
        evidence = build_piece_graph(cloud.graph, cloud.graph.scales, segmenter.state)
        for one in (replace(evidence, occlusions=None), evidence):
            labels = build_consensus([one], load_boundary_model()).at()
            judged = score(labels[cloud.of_point], scene.truth.points)
            found.append((judged.f, judged.best_iou))
    return found


if __name__ == "__main__":
    main()
