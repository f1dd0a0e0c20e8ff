"""Boundary detectors on BSDS500: `python benchmarks/boundaries.py BSDS_DIR FOREST`.

FOREST is one that has not seen val: `torchjoint train-boundaries BSDS_DIR --splits train -o FOREST`.

Boundaries: ODS, OIS and AP on val. Regions: the image segmentation by colours alone and with each detector's
boundaries, at the one setting, of as many drawn at random, that is best on every other image of val; scored on the
rest. (Not chosen on train, whose boundaries the forest knows by heart.)
"""

import argparse
import statistics
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import report
import torch
from torch import nn

from torchjoint.boundary import make_boundary
from torchjoint.boundary_scores import evaluate_predictions
from torchjoint.config import BoundaryConfig, ImageGraphConfig, ImageSegmentsConfig
from torchjoint.datasets.bsds import BsdsImage, bsds_images
from torchjoint.region_scores import RegionScores, RegionSetting, evaluate_regions

COLUMNS = ["covering", "symmetric", "F objects and parts"]


class Kept:
    """A detector's boundaries, each made once."""

    def __init__(self, detector: nn.Module) -> None:
        self.detector = detector
        self.boundaries: dict[str, torch.Tensor] = {}
        self.seconds = 0.0

    def __call__(self, record: BsdsImage) -> torch.Tensor:
        if record.name not in self.boundaries:
            image = record.image[None]
            start = time.perf_counter()
            self.boundaries[record.name] = self.detector(image)[0]
            self.seconds += time.perf_counter() - start
        return self.boundaries[record.name]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("bsds", type=Path)
    parser.add_argument("forest", type=Path)
    parser.add_argument("--thresholds", type=int, default=99)
    parser.add_argument("--settings", type=int, default=60, help="that are tried for each way of segmenting")
    arguments = parser.parse_args()
    val = bsds_images(arguments.bsds, "val")
    forest = {"detector": "structured_forest", "model": str(arguments.forest)}
    detectors = {
        name: Kept(make_boundary(BoundaryConfig(**options)))
        for name, options in {
            "gradient": {"detector": "gradient"},
            "structured_forest": forest,
            "structured_forest, multi_scale": forest | {"multi_scale": True},
        }.items()
    }
    text = boundary_table(detectors, val, arguments.thresholds) + "\n\n"
    text += region_table({"no boundaries": None} | detectors, val[::2], val[1::2], arguments.settings)
    text += f"\n\n{report.machine()}."
    print(text)
    report.write_part("boundaries", text)


def boundary_table(detectors: dict[str, Kept], val: Sequence[BsdsImage], thresholds: int) -> str:
    rows = []
    for name, detector in detectors.items():
        for record in val:  # one after the other, for the sake of the time
            detector(record)
        scores = evaluate_predictions(detector, val, thresholds, progress=True)
        milliseconds = detector.seconds / len(val) * 1000
        rows.append([f"`{name}`", *(f"{value:.3f}" for value in scores[:6]), f"{milliseconds:.0f}"])
    columns = ["detector", "ODS", "at", "precision", "recall", "OIS", "AP", "ms an image"]
    return f"{report.table(columns, rows)}\n\n{len(val)} images of val, {thresholds} thresholds."


def region_table(
    detectors: dict[str, Kept | None], tuning: Sequence[BsdsImage], checking: Sequence[BsdsImage], settings: int
) -> str:
    rows, first = [], None
    for name, detector in detectors.items():
        predict = detector or (lambda record: torch.zeros_like(record.image[0]))
        drawn = draw(settings, detector is not None)
        best = chosen(drawn, evaluate_regions(predict, tuning, drawn, progress=True))
        each = [evaluate_regions(predict, [record], [best])[0] for record in checking]
        first = first or each
        rows.append([f"`{name}`", *compared(each, first), described(best)])
    columns = ["boundaries", *COLUMNS, "parameters"]
    return (
        f"{report.table(columns, rows)}\n\nEach way at the best of {settings} settings, by covering + F, on "
        f"{len(tuning)} images of val; scored on the other {len(checking)}. In brackets the mean difference from no "
        "boundaries, image by image, and its standard error."
    )


def compared(each: Sequence[RegionScores], first: Sequence[RegionScores]) -> list[str]:
    cells = []
    for column in range(len(COLUMNS)):
        values = [row[column] for row in each]
        differences = [value - row[column] for value, row in zip(values, first, strict=True)]
        error = statistics.stdev(differences) / len(differences) ** 0.5
        cell = f"{statistics.mean(values):.3f}"
        cells.append(cell if each is first else f"{cell} ({statistics.mean(differences):+.3f} ± {error:.3f})")
    return cells


def draw(count: int, with_boundaries: bool, seed: int = 0) -> list[RegionSetting]:
    """Parameters at random, evenly on a logarithmic scale. One weight is 1: that all grow alike is `scale`'s matter."""
    random = np.random.default_rng(seed)

    def between(low: float, high: float) -> float:
        return float(f"{np.exp(random.uniform(np.log(low), np.log(high))):.3g}")

    settings = []
    for _ in range(count):
        smoothing = float(random.choice([0.0, 0.5, 0.8, 1.2]))
        color = between(0.05, 3) if with_boundaries else 1.0
        scale, min_size = between(0.3, 30), round(between(50, 3000))
        graph = ImageGraphConfig(smoothing=smoothing, color_weight=color, boundary_weight=float(with_boundaries))
        settings.append(RegionSetting(graph, ImageSegmentsConfig(scale=scale, min_size=min_size)))
    return settings


def chosen(settings: Sequence[RegionSetting], scores: Sequence[RegionScores]) -> RegionSetting:
    return settings[max(range(len(settings)), key=lambda i: scores[i].covering + scores[i].f)]


def described(setting: RegionSetting) -> str:
    graph, segments = setting
    return (
        f"color_weight {graph.color_weight:g}, boundary_weight {graph.boundary_weight:g}, "
        f"smoothing {graph.smoothing:g}, scale {segments.scale:g}, min_size {segments.min_size}"
    )


if __name__ == "__main__":
    main()
