"""Draws results on real data for the README: `python benchmarks/gallery.py OUT.png TITLE=RESULT ...`.

Each RESULT is a folder that `torchjoint segment` wrote. The figure shows only computed results, no photographs: the
final label images and the cloud; one colour is one object.
"""

import argparse
from pathlib import Path

import torch
import yaml
from matplotlib.figure import Figure

import torchjoint as tj
from torchjoint.datasets.files import read_label_image
from torchjoint.results.folder import read_points
from torchjoint.results.label_colors import label_colors
from torchjoint.results.render import render_cloud

MOST_IMAGES = 6


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("results", nargs="+", help="TITLE=FOLDER")
    arguments = parser.parse_args()
    results = [result.rpartition("=")[::2] for result in arguments.results]
    figure = Figure(figsize=(12, 3.1 * len(results)), layout="constrained")
    for part, (title, folder) in zip(figure.subfigures(len(results), 1, squeeze=False)[:, 0], results, strict=True):
        draw(part, title, Path(folder))
    figure.savefig(arguments.out, dpi=100)


def draw(part: Figure, title: str, folder: Path) -> None:
    points = read_points(folder)
    count = yaml.safe_load((folder / "run.yaml").read_text())["counts"]["point_segments"]
    images = [read_label_image(file) - 1 for file in sorted((folder / "images").glob("*.png"))]
    chosen = torch.linspace(0, len(images) - 1, min(len(images), MOST_IMAGES)).round().long().tolist()
    left, right = part.subfigures(1, 2, width_ratios=[2, 1])
    columns = min(3, len(chosen))
    rows = -(-len(chosen) // columns)
    for axis, index in zip(left.subplots(rows, columns, squeeze=False).flat, chosen, strict=False):
        axis.imshow(label_colors(images[index], count).numpy())
        axis.set(xticks=[], yticks=[])
    images_of = f"{len(images)} image{'s' * (len(images) > 1)}"
    left.suptitle(f"{title}: {images_of}, {len(points.points):,} points, {count} segments", fontsize=10)
    axis = right.subplots()
    source = yaml.safe_load((folder / "run.yaml").read_text())["scene"]
    scene = tj.Scene(points.points, tj.load_scene(source).frames)
    axis.imshow(render_cloud(scene, label_colors(points.labels)).numpy())
    axis.set(xticks=[], yticks=[])


if __name__ == "__main__":
    main()
