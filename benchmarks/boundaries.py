"""Boundary detectors on BSDS500: `python benchmarks/boundaries.py BSDS_DIR [--detector NAME]`.

Boundaries: ODS, OIS and AP on val. Regions: the image segmentation with the detector's boundaries and by colours alone,
each at the one setting, of as many drawn at random, that is best on train; scored on val.
"""

import argparse
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import report
import torch

from torchjoint.boundary import make_boundary
from torchjoint.boundary_scores import evaluate_boundaries
from torchjoint.config import BoundaryConfig, ImageGraphConfig, ImageSegmentsConfig
from torchjoint.datasets.bsds import BsdsImage, bsds_images
from torchjoint.region_scores import RegionScores, RegionSetting, evaluate_regions


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("bsds", type=Path)
    parser.add_argument("--detector", default="gradient")
    parser.add_argument("--thresholds", type=int, default=99)
    parser.add_argument("--settings", type=int, default=48, help="that are tried on train, for each side")
    parser.add_argument("--train-images", type=int, default=50, help="evenly spread over train")
    parser.add_argument("--val-images", type=int, default=100, help="evenly spread over val")
    arguments = parser.parse_args()
    train = spread(bsds_images(arguments.bsds, "train"), arguments.train_images)
    val = spread(bsds_images(arguments.bsds, "val"), arguments.val_images)
    detector = make_boundary(BoundaryConfig(detector=arguments.detector))

    def predict(record: BsdsImage) -> torch.Tensor:
        return detector(record.image[None])[0]

    start = time.perf_counter()
    scores = evaluate_boundaries(detector, val, arguments.thresholds, progress=True)
    seconds = time.perf_counter() - start
    text = report.table(
        ["detector", "ODS", "at", "precision", "recall", "OIS", "AP"],
        [[f"`{arguments.detector}`", *(f"{value:.3f}" for value in scores[:6])]],
    )
    text += f"\n\n{len(val)} images of val, {arguments.thresholds} thresholds, {seconds:.0f} s.\n\n"

    drawn = {name: draw(arguments.settings, has) for name, has in (("without", False), ("with", True))}
    found = evaluate_regions(predict, train, [one for settings in drawn.values() for one in settings], progress=True)
    best = {
        "without": chosen(drawn["without"], found[: arguments.settings]),
        "with": chosen(drawn["with"], found[arguments.settings :]),
    }
    regions = evaluate_regions(predict, val, list(best.values()), progress=True)
    text += report.table(
        ["boundaries", "covering", "symmetric", "F objects and parts", "segments", "parameters"],
        [
            [name, *(f"{value:.3f}" for value in row[:3]), f"{row.num_segments:.0f}", described(best[name])]
            for name, row in zip(best, regions, strict=True)
        ],
    )
    text += f"\n\nEach the best of {arguments.settings} settings on {len(train)} images of train, by covering + F.\n\n"
    text += f"{report.machine()}."
    print(text)
    report.write_part(f"boundaries {arguments.detector}", text)


def spread(records: Sequence[BsdsImage], count: int) -> list[BsdsImage]:
    places = np.unique(np.linspace(0, len(records) - 1, min(count, len(records))).round().astype(int))
    return [records[place] for place in places]


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
