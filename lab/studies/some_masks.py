"""Masks of some things: what becomes of things with and without masks when a detector knows only a share of them.

`python lab/studies/some_masks.py WORK [--scenes 3] [--domains room table ...] [--write]`. Each scene is run four times
with points moved by 0.1 mm and other masks (errors like SAM's, 15 views), without masks, with masks of everything, and
with masks of a share of the things, but of nothing else. WORK keeps the scores of each scene, so that an interrupted
command goes on, and gets some_masks.png; `--write` puts the table in README.md, and the picture in docs/.
"""

import argparse
import json
import shutil
from dataclasses import replace
from pathlib import Path
from statistics import fmean

import report
import torch
from torch import Tensor
from torchjoint_lab.evaluation.table import standard_error
from torchjoint_lab.synthetic import known_things, make_domain_scene, with_network_masks

import torchjoint as tj
from torchjoint.runtime.files import write_text
from torchjoint.scene import Scene

DOMAINS = ("room", "kitchen", "desk", "table", "shelf")
#: No number of the method was chosen on scenes from here on.
FIRST_SEED = 130
SHARES = (0.2, 0.4, 0.6, 0.8)
RUNS = 4
MOVED = 1e-4  # metres
DOCS = Path(__file__).parents[2] / "docs"
#: For each share: best IoU of things with masks, now and with masks of everything; of all others, now and without any.
Scores = dict[str, tuple[float, float, float, float]]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("work", type=Path)
    parser.add_argument("--scenes", type=int, default=3)
    parser.add_argument("--domains", nargs="+", choices=DOMAINS, default=DOMAINS)
    report.add_write(parser, "the table in lab/studies/README.md, and its picture")
    arguments = parser.parse_args()
    arguments.work.mkdir(parents=True, exist_ok=True)
    scores: dict[str, list[Scores]] = {}
    for domain in arguments.domains:
        for seed in range(FIRST_SEED, FIRST_SEED + arguments.scenes):
            path = arguments.work / f"{domain}-{seed}.json"
            if not path.is_file():
                write_text(path, json.dumps(scores_of(make_domain_scene(domain, seed, num_views=15).scene)))
            scores.setdefault(domain, []).append(json.loads(path.read_text(encoding="utf-8")))
            print(path.stem, flush=True)
    text = table(scores)
    print(text)
    plot([of_scene for of_domain in scores.values() for of_scene in of_domain], arguments.work / "some_masks.png")
    if arguments.write:
        report.write_part("masks of some things", text)
        shutil.copyfile(arguments.work / "some_masks.png", DOCS / "some_masks.png")


def scores_of(scene: Scene) -> Scores:
    """Means over the runs of one scene."""
    rows: dict[str, list[tuple[float, ...]]] = {}
    for run in range(RUNS):
        noise = torch.randn(scene.points.shape, generator=torch.Generator().manual_seed(run))
        moved = replace(scene, points=scene.points + MOVED * noise)
        without = best_ious(moved)
        everything = best_ious(with_network_masks(moved, "sam-like", run))
        for share in SHARES:
            found = best_ious(with_network_masks(moved, "sam-like", run, share))
            known = torch.isin(true_instances(scene), known_things(scene, share, run))
            values = found[known], everything[known], found[~known], without[~known]
            rows.setdefault(str(share), []).append(tuple(float(value.mean()) for value in values))
    return {share: tuple(map(fmean, zip(*of_share, strict=True))) for share, of_share in rows.items()}


def true_instances(scene: Scene) -> Tensor:
    """[K] int64, ascending."""
    assert scene.truth is not None
    assert scene.truth.points is not None
    return torch.unique(scene.truth.points[scene.truth.points >= 0])


def best_ious(scene: Scene) -> Tensor:
    """For each true instance, the IoU of the best segment: [K] float64."""
    segmenter = tj.JointSegmenter()
    segmenter.reset(scene.points, scene.colors, scene.normals)
    for frame in scene.frames:
        segmenter.update(frame)
    found = segmenter.compute(images=False).points
    assert scene.truth is not None
    assert scene.truth.points is not None
    best = []
    for instance in true_instances(scene):
        inside = torch.bincount(found[scene.truth.points == instance], minlength=int(found.max()) + 1).double()
        best.append((inside / (torch.bincount(found) + inside.sum() - inside)).max())
    return torch.stack(best)


def table(scores: dict[str, list[Scores]]) -> str:
    """A row for each kind of scene and share, and for all kinds."""
    columns = ["masks of", "with masks", "of everything", "without masks", "without any"]
    scenes = [of_scene for of_domain in scores.values() for of_scene in of_domain]
    rows = [row(f"{share:.0%} of the things", [one[str(share)] for one in scenes], True) for share in SHARES]
    rows += [row(f"40 %, {domain}", [one["0.4"] for one in of_domain], False) for domain, of_domain in scores.items()]
    return report.table(columns, rows)


def row(title: str, values: list[tuple[float, float, float, float]], with_error: bool) -> list[str]:
    cells = [title, *(f"{fmean(column):.3f}" for column in zip(*values, strict=True))]
    if with_error:
        for place in (0, 2):
            differences = [one[place] - one[place + 1] for one in values]
            cells[place + 1] += f" ({fmean(differences):+.3f} ± {standard_error(differences):.3f})"
    return cells


def plot(scenes: list[Scores], path: Path) -> None:
    """Draws the four scores against the share of the things that have masks."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    names = ("things with masks", "the same, masks of everything", "all others", "the same, no masks at all")
    figure, axis = plt.subplots(figsize=(6, 3.5), layout="constrained")
    for place, (name, style) in enumerate(zip(names, ("C0o-", "C0--", "C1o-", "C1--"), strict=True)):
        means = [fmean(scene[str(share)][place] for scene in scenes) for share in SHARES]
        axis.plot([100 * share for share in SHARES], means, style, label=name)
    axis.set_xlabel("things with masks, %")
    axis.set_ylabel("best IoU of the points")
    axis.set_ylim(0, 1)
    axis.grid(alpha=0.3)
    axis.legend(fontsize=8)
    figure.savefig(path, dpi=100)


if __name__ == "__main__":
    main()
