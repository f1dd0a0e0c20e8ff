"""Boundary detectors on BSDS500: `python lab/studies/boundaries.py BSDS_DIR FOREST`.

FOREST must not be trained on val: `torchjoint-lab train-forest BSDS_DIR --splits train -o FOREST`.

Boundaries: ODS, OIS and AP on val. Regions: the image segmentation by colour alone, and with each detector's
boundaries, raw and closed. The best of `--settings` random settings is chosen on one half of val and scored on the
other half, and vice versa. (Settings are not chosen on train, since the forest is trained on it.)
"""

import argparse
import statistics
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import report
import torch
from torch import nn
from torchjoint_lab.datasets.bsds import BsdsImage, bsds_images
from torchjoint_lab.evaluation.boundary_scores import evaluate_predictions
from torchjoint_lab.evaluation.region_scores import RegionScores, RegionSetting, evaluate_regions

from torchjoint.config import BoundaryConfig, ImageGraphConfig, ImageSegmentsConfig
from torchjoint.images.boundary import make_boundary

Predictor = Callable[[BsdsImage], torch.Tensor]
COLUMNS = ["covering", "symmetric", "F objects and parts"]


class Kept:
    """A detector that caches its boundaries by image."""

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
    parser.add_argument("--part", choices=("boundaries", "regions"), help="only this one")
    parser.add_argument("--thresholds", type=int, default=99)
    parser.add_argument("--settings", type=int, default=15, help="that are tried for each way of segmenting")
    parser.add_argument("--images", type=int, default=100, help="of val, evenly spread")
    report.add_write(parser, "the tables in lab/studies/README.md")
    arguments = parser.parse_args()
    if arguments.images < 2:
        parser.error(f"--images: expected at least 2, one for each half, got {arguments.images}")
    val = bsds_images(arguments.bsds, "val")
    val = val[:: max(1, len(val) // arguments.images)][: arguments.images]
    forest = {"detector": "structured_forest", "model": str(arguments.forest)}
    detectors = {
        name: Kept(make_boundary(BoundaryConfig(**options)))
        for name, options in {
            "gradient": {"detector": "gradient"},
            "structured_forest": forest,
            "structured_forest, multi_scale": forest | {"multi_scale": True},
        }.items()
    }
    if arguments.part != "regions":
        show("boundaries", boundary_table(detectors, val, arguments.thresholds), arguments.write)
    if arguments.part != "boundaries":
        show("regions", region_table(detectors, (val[::2], val[1::2]), arguments.settings), arguments.write)


def show(part: str, table: str, write: bool) -> None:
    report.show(part, f"{table}\n\n{report.machine()}.", write)


def boundary_table(detectors: dict[str, Kept], val: Sequence[BsdsImage], thresholds: int) -> str:
    rows = []
    for name, detector in detectors.items():
        for record in val:  # one after the other, to measure the time
            detector(record)
        scores = evaluate_predictions(detector, val, thresholds, progress=True)
        milliseconds = detector.seconds / len(val) * 1000
        rows.append([f"`{name}`", *(f"{value:.3f}" for value in scores[:6]), f"{milliseconds:.0f}"])
    columns = ["detector", "ODS", "at", "precision", "recall", "OIS", "AP", "ms an image"]
    return f"{report.table(columns, rows)}\n\n{len(val)} images of val, {thresholds} thresholds."


def region_table(detectors: dict[str, Kept], halves: Sequence[Sequence[BsdsImage]], settings: int) -> str:
    ways: list[tuple[str, str, Predictor]] = [
        ("no boundaries", "colours", lambda record: torch.zeros_like(record.image[0]))
    ]
    ways += [("structured_forest", "boundaries", detectors["structured_forest"])]
    ways += [(name, "closed", kept) for name, kept in detectors.items()]
    rows, first = [], None
    for name, way, predict in ways:
        drawn = draw(settings, way)
        each, best = [], []
        for tuning, checking in (halves, halves[::-1]):
            best.append(chosen(drawn, evaluate_regions(predict, tuning, drawn, progress=True)))
            each += [evaluate_regions(predict, [record], best[-1:])[0] for record in checking]
        first = first or each
        parameters = " / ".join(map(described, best))
        rows.append([f"`{name}`" + ", closed" * (way == "closed"), *compared(each, first), parameters])
    columns = ["boundaries", *COLUMNS, "parameters"]
    return (
        f"{report.table(columns, rows)}\n\nEach way at the best of {settings} settings, by covering + F, on one half "
        f"of val, scored on the other, and the other way round: {len(first or ())} images. In brackets the mean "
        "difference from no boundaries, image by image, and its standard error. Closed: `contours.closed`."
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


def draw(count: int, way: str, seed: int = 0) -> list[RegionSetting]:
    """Draws random settings, most parameters uniform on a logarithmic scale, in ranges from earlier, wider searches."""
    random = np.random.default_rng(seed)

    def between(low: float, high: float) -> float:
        return float(f"{np.exp(random.uniform(np.log(low), np.log(high))):.3g}")

    settings = []
    for _ in range(count):
        min_size = round(between(500, 3000))
        if way == "colours":
            contours = None
            graph = ImageGraphConfig(float(random.choice([0.8, 1.0])), color_weight=1.0, boundary_weight=0.0)
            scale = between(1.5, 4.5)
        elif way == "boundaries":
            contours = None
            graph = ImageGraphConfig(0.8, color_weight=between(0.3, 30), boundary_weight=1.0)
            scale = graph.color_weight * between(1.5, 10)
        else:
            contours = float(random.choice([1.0, 1.5, 2.0])), float(random.choice([2, 3]))
            graph = ImageGraphConfig(0.8, color_weight=between(0.03, 0.25), boundary_weight=1.0)
            scale = graph.color_weight * between(50, 1500)
        settings.append(RegionSetting(contours, graph, ImageSegmentsConfig(scale, min_size)))
    return settings


def chosen(settings: Sequence[RegionSetting], scores: Sequence[RegionScores]) -> RegionSetting:
    return settings[max(range(len(settings)), key=lambda i: scores[i].covering + scores[i].f)]


def described(setting: RegionSetting) -> str:
    contours, graph, segments = setting
    closed = "" if contours is None else f"exponent {contours[1]:g}, smoothing {contours[0]:g}; "
    return (
        f"{closed}color_weight {graph.color_weight:g}, boundary_weight {graph.boundary_weight:g}, "
        f"smoothing {graph.smoothing:g}, scale {segments.scale:.3g}, min_size {segments.min_size}"
    )


if __name__ == "__main__":
    main()
