"""Parameter sensitivity: `python lab/studies/sensitivity.py SUITE [--data FOLDER] [--scenes COUNT]`.

Varies one parameter at a time around the suite's preset, on the suite's tuning half. Draws sensitivity-SUITE.png into
the current folder, with --write into lab/studies/.
"""

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import fmean
from typing import Any, NamedTuple

import report
import suite_arguments
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from torchjoint_lab.benchmark.case import Case
from torchjoint_lab.benchmark.methods import METHODS, changed
from torchjoint_lab.benchmark.presets import preset_config
from torchjoint_lab.benchmark.search import run_scores
from torchjoint_lab.benchmark.suites import Suite, load_all
from tqdm import tqdm

from torchjoint.config import Config, evidence_config
from torchjoint.evaluation.scores import Scores

IMAGE_LABELS = {
    "refinement.color_weight": (0, 25, 50, 100, 200, 400),
}
REGIONS = {
    "region_costs.weight": (0, 0.05, 0.1, 0.2, 0.4, 0.6, 0.8, 1.2),
    "region_costs.overlap_threshold": (0.3, 0.5, 0.6, 0.7, 0.8, 0.9),
    "propagation.window": (1, 3, 5, 7, 11),
    "image_segments.scale": (0.5, 1, 3, 6, 12, 30),
    "pieces.threshold": (None, 0.01, 0.02, 0.05, 0.1, 0.2),
    "region_merging.threshold": (0.15, 0.2, 0.3, 0.35, 0.45, 0.5, 0.6),
    "region_merging.agreement": (0, 0.2, 0.4, 0.6, 0.8, 1),
    "region_merging.min_size": (3, 5, 15, 50, 150, 300, 600),
    "image_support.min_size": (0, 100, 250, 500, 1000),
    "image_support.overlap": (0.3, 0.5, 0.6, 0.7, 0.8, 0.9),
    "point_graph.neighbors": (8, 12, 16, 24, 32),
    "region_costs.normal_neighbors": (15, 20, 30, 45, 60, 80),
    "region_costs.convex_factor": (0, 0.02, 0.05, 0.1, 0.2, 0.4, 1),
}
SCAN = {
    "scan.object_height": (0, 0.15, 0.2, 0.25, 0.3, 0.4),
    "scan.gap": (0.05, 0.1, 0.2, 0.3, 0.5, 0.8),
    "scan.gap_growth": (0, 0.01, 0.015, 0.02, 0.03, 0.05),
    "scan.min_size": (0, 5, 10, 15, 25, 50),
}


class Panel(NamedTuple):
    """One parameter, its values and their scores."""

    name: str
    preset: Any
    values: list[Any]  #: ascending, with the preset's value
    space: str  #: "3D" or "2D"
    means: list[Scores]  #: over the scenes, one per value


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    suite_arguments.add(parser)
    names = [*REGIONS, *SCAN, *IMAGE_LABELS]
    parser.add_argument("--parameters", nargs="+", choices=names, default=names, help="only these")
    report.add_write(parser, "the picture in lab/studies/")
    arguments = parser.parse_args()
    suite = suite_arguments.suite_of(arguments)
    found = panels(suite, arguments.data, arguments.parameters)
    if not found:
        parser.error(f"--parameters: suite {suite.name} has no scores for any of {', '.join(arguments.parameters)}")
    for panel in found:
        pairs = zip(panel.values, panel.means, strict=True)
        print(
            f"{panel.name} = {panel.preset}, {panel.space} F / best IoU:",
            ", ".join(f"{text(value)}: {mean.f:.3f} / {mean.best_iou:.3f}" for value, mean in pairs),
        )
    folder = Path(__file__).parent if arguments.write else Path()
    draw(found, suite).savefig(folder / f"sensitivity-{suite.name}.png", dpi=75)


def panels(suite: Suite, data: Path | None, parameters: Sequence[str]) -> list[Panel]:
    """Runs every parameter's values on all scenes; leaves out image parameters if no image has ground truth."""
    preset = preset_config(suite.preset)
    ranges = SCAN if preset.point_segments.method == "scan" else REGIONS
    spaces = dict.fromkeys(ranges, "3D") | dict.fromkeys(IMAGE_LABELS, "2D")
    values = {
        name: with_preset(of_name, value_in(preset, name))
        for name, of_name in (ranges | IMAGE_LABELS).items()
        if name in parameters
    }
    runs = [(name, value, spaces[name]) for name, of_name in values.items() for value in of_name]
    scores: dict[tuple[str, Any], list[Scores]] = {}
    scenes = suite.scenes("tuning", data)
    bar = tqdm(total=len(scenes) * len(runs), unit="run")
    for scene in load_all(scenes):
        case = Case(scene, suite.config, preset)
        known: dict[tuple[Config, bool], Mapping[str, Scores]] = {}
        for name, value, space in by_what_is_seen(preset, runs):
            key = changed(preset, {name: value}), space == "2D"
            if key not in known:
                known[key] = run_scores(METHODS["joint"], {name: value}, case, images=space == "2D")
            if space in known[key]:
                scores.setdefault((name, value), []).append(known[key][space])
            bar.update()
    return [
        Panel(name, value_in(preset, name), of_name, spaces[name], [mean(scores[name, value]) for value in of_name])
        for name, of_name in values.items()
        if (name, of_name[0]) in scores
    ]


def by_what_is_seen(preset: Config, runs: Sequence[tuple[str, Any, str]]) -> list[tuple[str, Any, str]]:
    """Sorts the runs: first those that see a scene as the preset does, since only the last views are cached."""
    seen = evidence_config(preset)
    return sorted(runs, key=lambda run: evidence_config(changed(preset, {run[0]: run[1]})) != seen)


def value_in(config: Config, name: str) -> Any:
    """Returns the value of stage.parameter."""
    stage, _, parameter = name.partition(".")
    return getattr(getattr(config, stage), parameter)


def with_preset(values: Sequence[Any], preset: Any) -> list[Any]:
    """Returns the values with the preset's, ascending; None, which switches a stage off, comes first."""
    return sorted({*values, preset}, key=lambda value: -1 if value is None else value)


def text(value: float | None) -> str:
    return "null" if value is None else f"{value:g}"


def mean(scores: Sequence[Scores]) -> Scores:
    return Scores(*map(fmean, zip(*scores, strict=True)))


def draw(found: Sequence[Panel], suite: Suite, columns: int = 4) -> Figure:
    """Draws a small plot per parameter, all with the same scale."""
    rows = -(-len(found) // columns)
    figure = Figure(figsize=(3.1 * columns, 1.8 * rows + 0.5), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).flat
    for panel in found:
        draw_panel(next(axes), panel, found)
    for axis in axes:
        axis.set_axis_off()
    lines = figure.axes[0].get_lines()[:2]
    figure.legend(lines, ["F", "best IoU"], loc="outside upper right", ncols=2, fontsize=9)
    figure.suptitle(
        f"{suite.name}: one parameter changed at a time; dashed: preset {suite.preset}", fontsize=10, x=0.35
    )
    return figure


def draw_panel(axis: Axes, panel: Panel, all_panels: Sequence[Panel]) -> None:
    """Draws one plot with evenly spaced values: most values are multiplicative steps, and some are 0."""
    places = range(len(panel.values))
    axis.plot(places, [scores.f for scores in panel.means], marker=".")
    axis.plot(places, [scores.best_iou for scores in panel.means], marker=".")
    axis.axvline(panel.values.index(panel.preset), color="grey", linestyle="--", linewidth=1)
    shown = [score for p in all_panels for scores in p.means for score in (scores.f, scores.best_iou)]
    margin = 0.05 * (max(shown) - min(shown)) + 1e-3
    axis.set_ylim(min(shown) - margin, max(shown) + margin)
    axis.set_xticks(places, [text(value) for value in panel.values], fontsize=7)
    axis.tick_params(axis="y", labelsize=7)
    axis.set_title(f"{panel.name} ({panel.space})", fontsize=8)
    axis.grid(alpha=0.3)


if __name__ == "__main__":
    main()
