"""Ablation study: `python lab/studies/ablation.py SUITE [--data FOLDER]`.

Runs the package's preset for the suite, then the same with one stage switched off, switched on or replaced by a simpler
stage. Differences are paired by scene, so that they have standard errors.
"""

import argparse
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from statistics import fmean
from typing import Any, NamedTuple
from unittest import mock

import report
import suite_arguments
from torchjoint_lab.benchmark.case import Case
from torchjoint_lab.benchmark.method import Method, Result
from torchjoint_lab.benchmark.methods import METHODS, changed, joint
from torchjoint_lab.benchmark.presets import preset_config
from torchjoint_lab.benchmark.run import compare
from torchjoint_lab.benchmark.settings import read_settings
from torchjoint_lab.benchmark.space import Setting
from torchjoint_lab.benchmark.suites import Suite

from torchjoint.evaluation.table import Row, markdown, standard_error, write_csv
from torchjoint.segments.planes import SmoothRegions

#: A weight without effect on decisions, but not 0, which would switch off the images: agreement and image support stay.
NEXT_TO_NOTHING = 1e-9


class Switch(NamedTuple):
    """An ablation of one stage: off if the preset has the stage, on if the preset does not."""

    title: str
    off: Setting
    on: Setting | None = None
    changes_points: bool = True
    constants: Mapping[str, Any] = {}  #: changed in addition, by name: "torchjoint.segments.scan.ground.MAX_BUMP"


IMAGE_LABELS = tuple(
    Switch(
        title,
        {f"refinement.{name}": value for name, value in off.items()},
        changes_points=False,
        constants={f"torchjoint.labels.geodesic.{name}": value for name, value in constants.items()},
    )
    for title, off, constants in (
        ("colours and boundaries in label propagation (nearest point)", {"color_weight": 0}, {}),
        (  # boundaries keep their cost of 50
            "colours in label propagation",
            {"color_weight": NEXT_TO_NOTHING},
            {"BOUNDARY_SHARE": 50 / NEXT_TO_NOTHING},
        ),
        ("boundaries in label propagation", {}, {"BOUNDARY_SHARE": 0}),
        ("removal of specks in images", {}, {"MIN_POINTS": 1}),
        ("separate ids for unseen image segments", {}, {"UNSEEN": 1e9}),
    )
)
REGIONS = (
    Switch("images in 3D", {"region_costs.weight": 0}),
    Switch("images in region merging", {"region_costs.weight": NEXT_TO_NOTHING, "region_merging.agreement": 0}),
    Switch("disagreement of images in region merging", {"region_costs.weight": NEXT_TO_NOTHING}),
    Switch("agreement of images in region merging", {"region_merging.agreement": 0}),
    Switch("pieces", {"pieces.threshold": None}, {"pieces.threshold": 0.03}),
    Switch("image support", {"image_support.min_size": 0}, {"image_support.min_size": 500}),
    Switch("occlusion bridging", {"occlusion_bridging.min_votes": None}, {"occlusion_bridging.min_votes": 4}),
    Switch("convexity in region merging", {"region_costs.convex_factor": 1}),
    Switch(
        "small regions (planes are those of all neighbours)",
        {},
        constants={"torchjoint_lab.regions.method.SMOOTH_REGIONS": SmoothRegions(scale=0)},
    ),
    *IMAGE_LABELS,
)
SCAN = (
    Switch("growth of the ground over what nothing rises from", {"scan.object_height": 0}),
    Switch("removal of bumps from the ground", {}, constants={"torchjoint.segments.scan.ground.MAX_BUMP": 1e3}),
    Switch(
        "the distance limit for joining small segments",
        {},
        constants={"torchjoint.segments.scan.gaps.JOINING_GAP": 1e6},
    ),
    Switch("joining of small segments", {"scan.min_size": 0}),
    Switch("growth of the gap with distance", {"scan.gap_growth": 0}),
    *IMAGE_LABELS,
)

#: Columns of the table: space and score.
COLUMNS = tuple(("3D", name) for name in ("F", "best IoU", "flat IoU")) + tuple(
    ("2D", name) for name in ("F", "best IoU")
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    suite_arguments.add(parser)
    parser.add_argument("--half", choices=("checking", "tuning"), default="checking")
    parser.add_argument("--page", type=Path, help="Markdown file with the marks <!-- ablation SUITE -->")
    parser.add_argument("--csv", type=Path, help="file for the scores of each scene")
    arguments = parser.parse_args()
    suite = suite_arguments.suite_of(arguments)
    part = f"ablation {suite.name}"
    if arguments.page:
        report.check_part(part, arguments.page)  # an error must come before hours of work
    methods, settings = variants(suite)
    rows: list[Row] = []
    for of_scene in compare(suite, methods, settings, arguments.data, arguments.half):
        rows += of_scene
        if arguments.csv:
            write_csv(arguments.csv, rows)
    text = table(rows, methods, suite, arguments.half)
    print(text)
    if arguments.page:
        report.write_part(part, text, arguments.page)


def variants(suite: Suite) -> tuple[list[Method], Mapping[str, Setting]]:
    """Returns the full method and its ablations, each with its setting; ablations without any effect are left out."""
    preset = preset_config(suite.preset)
    method, switches = ("scan", SCAN) if preset.point_segments.method == "scan" else ("regions", REGIONS)
    found = {(preset, ""): Method("joint", f"full method, preset {suite.preset}", joint)}
    for switch in switches:
        off, on = changed(preset, switch.off), changed(preset, switch.on or {})
        is_off = off != preset or switch.constants
        config, word, setting = (off, "without", switch.off) if is_off else (on, "with", switch.on or {})
        key = config, str(switch.constants or "")
        if key not in found:
            like = None if switch.changes_points else "joint"
            run = partial(_run, setting, switch.constants)
            found[key] = Method(switch.title, f"{word} {switch.title}", run, like=like)
    # The rest sees the scene differently. Only the views of the last config are cached, so the rest comes at the end.
    tuned = read_settings(suite.tuned_as or suite.name).get("edges", {})
    title = f"without {method} (edges, as in the paper, at their best setting)"
    return [*found.values(), replace(METHODS["edges"], title=title)], {"edges": tuned}


def _run(setting: Setting, constants: Mapping[str, Any], case: Case, _: Setting, images: bool) -> Result:
    with ExitStack() as stack:
        for name, value in constants.items():
            stack.enter_context(mock.patch(name, value))
        return joint(case, setting, images)


def table(rows: Sequence[Row], methods: Sequence[Method], suite: Suite, half: str) -> str:
    """Returns a table of the full method's scores, and of the other methods' differences to them."""
    scenes = len({row.scene for row in rows})
    values = {(row.method, row.space, name, row.scene): v for row in rows for name, v in measured(row).items()}
    columns = [column for column in COLUMNS if any(key[1:3] == column for key in values)]
    body = []
    for method in methods:
        cells = [cell(values, method.name, *column) for column in columns]
        if any(cells):
            body.append([method.title, *cells])
    return (
        f"{scenes} {half} scenes: {suite.what}. Means over the scenes; below the full method's the differences to it, "
        "scene by scene, with their standard errors, bold where they are more than twice that.\n\n"
        + markdown([suite.name, *(" ".join(column) for column in columns)], body)
    )


def measured(row: Row) -> dict[str, float]:
    """Returns the values of a row that the table shows."""
    flat = {"flat IoU": row.kinds["flat"]} if "flat" in row.kinds else {}
    return {"F": row.scores.f, "best IoU": row.scores.best_iou, **flat}


def cell(values: Mapping[tuple[str, str, str, str], float], method: str, space: str, name: str) -> str:
    """Returns the mean of the full method; for another method, the mean difference to the full method."""
    of_method = {key[3]: value for key, value in values.items() if key[:3] == (method, space, name)}
    if not of_method:
        return ""
    if method == "joint":
        return f"{fmean(of_method.values()):.3f}"
    differences = [v - values["joint", space, name, scene] for scene, v in of_method.items()]
    mean, error = fmean(differences), standard_error(differences)
    text = f"{round(mean, 3) + 0:+.3f}"  # + 0: no minus sign before a zero
    if len(differences) == 1:
        return text
    text = f"{text} ± {error:.3f}"
    return f"**{text}**" if abs(mean) > 2 * error else text


if __name__ == "__main__":
    main()
