"""Masks of a network: what each part of the merging contributes, and what views and pose errors do.

`python lab/studies/mask_curves.py WORK [--scenes 3] [--noise-seeds 1] [--domains room table shelf]
[--write]`. Scores are F for objects and parts / mean best
IoU of the points, means over generated rooms, table-tops and shelves (seeds from 116 on) with masks of one level; in
parentheses their differences to the scores of the unchanged method, run by run, with standard errors. WORK keeps the
scores of each run, so that an interrupted command goes on, and gets mask_curves.png.
"""

import argparse
import json
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from statistics import fmean

import report
import torch
from torchjoint_lab.evaluation.scores import score
from torchjoint_lab.evaluation.table import standard_error
from torchjoint_lab.synthetic import make_domain_scene, with_network_masks

import torchjoint as tj
from torchjoint.runtime.files import write_text
from torchjoint.scene import Scene
from torchjoint.segments.learned import agglomeration
from torchjoint.segments.learned import masks as of_masks

DOMAINS = ("room", "table", "shelf")
FIRST_SEED = 116
PLOT = "mask_curves.png"
LEVELS = ("sam-like", "hard")
NUM_VIEWS = (1, 2, 4, 8, 15, 30, 60)
POSE_ERRORS = (0.0, 0.5, 1.0, 2.0, 3.0)  # cm
#: Views of the ablation and of the pose errors.
USUAL_VIEWS = 15

Patch = tuple[object, str, object]
#: What is changed, and how.
ABLATION: dict[str, list[Patch]] = {
    "all": [],
    "no masks": [],
    "apart counts as much as together": [(of_masks, "APART_WEIGHT", 1.0)],
    "no geometry": [
        (of_masks, "FIRST_PRIOR_WEIGHT", 1e-6),
        (of_masks, "LEAST_PRIOR_WEIGHT", 1e-6),
        (of_masks, "PRIOR_WEIGHT_OF_NOISE", 0.0),
    ],
    "geometry counts .1 views, whatever the noise": [
        (of_masks, "LEAST_PRIOR_WEIGHT", 0.1),
        (of_masks, "PRIOR_WEIGHT_OF_NOISE", 0.0),
    ],
    "only touching regions merge": [
        (of_masks.MaskLinkage, "far_pairs", lambda *_: torch.empty(2, 0, dtype=torch.int64))
    ],
    "superpoints are not cut": [(of_masks, "MIXED", 1.0)],
    "crumbs stay": [(of_masks, "MIN_SIZE", 1)],
    "merged at once, not in steps": [(agglomeration, "merging_steps", lambda thresholds: [(3, thresholds[-1])])],
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("work", type=Path)
    parser.add_argument("--scenes", type=int, default=3)
    parser.add_argument("--noise-seeds", type=int, default=1)
    parser.add_argument("--domains", nargs="+", choices=DOMAINS, default=DOMAINS)
    report.add_write(parser, f"the tables in lab/studies/README.md, and lab/studies/{PLOT}")
    arguments = parser.parse_args()
    arguments.work.mkdir(parents=True, exist_ok=True)
    scores: dict[str, list[tuple[float, float]]] = {}
    for domain in arguments.domains:
        for seed in range(FIRST_SEED, FIRST_SEED + arguments.scenes):
            made: list[Scene] = []
            for level in LEVELS:
                for noise in range(arguments.noise_seeds):
                    path = arguments.work / f"{domain}-{seed}-{level}-{noise}.json"
                    known = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
                    for key, run in jobs(level):
                        if key not in known:
                            made = made or [make_domain_scene(domain, seed, num_views=NUM_VIEWS[-1]).scene]
                            known[key] = run(made[0], noise)
                            write_text(path, json.dumps(known))
                        scores.setdefault(key, []).append(tuple(known[key]))
                    print(path.stem, flush=True)
    report.show("mask curves", tables(scores), arguments.write)
    plot(scores, arguments.work / PLOT)
    if arguments.write:
        shutil.copyfile(arguments.work / PLOT, Path(__file__).parent / PLOT)


def jobs(level: str) -> Iterator[tuple[str, Callable[[Scene, int], tuple[float, float]]]]:
    """The runs on one scene with masks of one level."""
    for name, patches in ABLATION.items():
        yield (
            f"{level}|{name}",
            lambda scene, noise, name=name, patches=patches: judged(
                scene.sample_frames(USUAL_VIEWS), None if name == "no masks" else level, noise, patches
            ),
        )
    for count in NUM_VIEWS:
        yield (
            f"{level}|{count} views",
            lambda scene, noise, count=count: judged(scene.sample_frames(count), level, noise),
        )
    for error in POSE_ERRORS[1:]:
        yield (
            f"{level}|{error} cm",
            lambda scene, noise, error=error: judged(scene.sample_frames(USUAL_VIEWS), level, noise, error=error / 100),
        )


def judged(
    scene: Scene, level: str | None, noise: int, patches: Sequence[Patch] = (), error: float = 0.0
) -> tuple[float, float]:
    """F and mean best IoU of the points."""
    truth = scene.truth
    assert truth is not None
    assert truth.points is not None
    masked = scene if level is None else with_network_masks(scene, level, seed=noise)
    if error:
        masked = replace(masked, frames=disturbed(masked, error, noise))
    with patched(patches):
        segmenter = tj.JointSegmenter()
        segmenter.reset(masked.points, masked.colors, masked.normals)
        for frame in masked.frames:
            segmenter.update(frame)
        found = score(segmenter.compute(images=False).points, truth.points)
    return found.f, found.best_iou


def disturbed(scene: Scene, error: float, seed: int) -> tuple[tj.Frame, ...]:
    """Frames whose cameras are moved by `error` metres (standard deviation), and turned by as many hundredths."""
    generator = torch.Generator().manual_seed(seed)

    def moved(frame: tj.Frame) -> tj.Frame:
        shift, turn = torch.randn(2, 3, dtype=torch.float64, generator=generator) * error / 3**0.5
        x, y, z = (turn * 0.3).tolist()  # a point 3 m away moves by about as much as the camera
        pose = torch.eye(4, dtype=torch.float64)
        skew = torch.tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=torch.float64)
        pose[:3, :3], pose[:3, 3] = torch.linalg.matrix_exp(skew), shift
        return replace(frame, world_to_camera=pose @ frame.world_to_camera)

    return tuple(moved(frame) for frame in scene.frames)


@contextmanager
def patched(patches: Sequence[Patch]) -> Iterator[None]:
    """Other values for constants and functions of the package."""
    before = [(owner, name, getattr(owner, name)) for owner, name, _ in patches]
    for owner, name, value in patches:
        setattr(owner, name, value)
    try:
        yield
    finally:
        for owner, name, value in before:
            setattr(owner, name, value)


def tables(scores: dict[str, list[tuple[float, float]]]) -> str:
    def row(name: str) -> list[str]:
        return [name, *(cell(scores[f"{level}|{name}"], scores[f"{level}|all"]) for level in LEVELS)]

    count = len(scores[f"{LEVELS[0]}|all"])
    columns = [f"{count} runs", *LEVELS]
    found = [
        report.table(columns, [row(name) for name in ABLATION]),
        report.table(columns, [row(f"{views} views") for views in NUM_VIEWS]),
        report.table(columns, [["0 cm", *row("all")[1:]], *(row(f"{error} cm") for error in POSE_ERRORS[1:])]),
    ]
    return "\n\n".join(found)


def plot(scores: dict[str, list[tuple[float, float]]], path: Path) -> None:
    """Draws the scores against the number of views and against the errors of the cameras' positions."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    curves = {
        "views": (NUM_VIEWS, [f"{views} views" for views in NUM_VIEWS]),
        "error of the cameras' positions, cm": (POSE_ERRORS, ["all", *(f"{error} cm" for error in POSE_ERRORS[1:])]),
    }
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.5), layout="constrained", sharey=True)
    for axis, (label, (places, names)) in zip(axes, curves.items(), strict=True):
        for level, color in zip(LEVELS, ("C0", "C1"), strict=True):
            f, iou = zip(*(map(fmean, zip(*scores[f"{level}|{name}"], strict=True)) for name in names), strict=True)
            axis.plot(places, f, "o-", color=color, label=f"{level}, F")
            axis.plot(places, iou, "o--", color=color, label=f"{level}, best IoU")
        axis.set_xlabel(label)
        axis.grid(alpha=0.3)
    axes[0].set_xscale("log")
    axes[0].set_xticks(NUM_VIEWS, [str(views) for views in NUM_VIEWS])
    axes[0].minorticks_off()
    axes[0].set_ylabel("score of the points")
    axes[1].legend(fontsize=8)
    figure.savefig(path, dpi=100)


def cell(scores: list[tuple[float, float]], usual: list[tuple[float, float]]) -> str:
    """Mean F and best IoU, and the differences to the usual ones with their standard errors."""
    f, iou = (fmean(values) for values in zip(*scores, strict=True))
    if scores == usual:
        return f"{f:.3f} / {iou:.3f}"
    gains = []
    for place in (0, 1):
        differences = [one[place] - other[place] for one, other in zip(scores, usual, strict=True)]
        gains.append(f"{fmean(differences):+.3f} ± {standard_error(differences):.3f}")
    return f"{f:.3f} / {iou:.3f} ({' / '.join(gains)})"


if __name__ == "__main__":
    main()
