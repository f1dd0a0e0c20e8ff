"""The tables of domains.py, from the files that it keeps."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import report

TITLES = {"mosd": "real table-tops (mOSD)", "ycb": "real desk (YCB-Video)"}
PRESETS = ("regions", "indoor", "tabletop")
SIMPLE = ("normals", "distance_normal_color", "ransac_dbscan")


def show_tables(work: Path, kinds: Sequence[str], runs: int, write: bool) -> None:
    """Prints the tables of what has been scored so far; `write`: also into lab/studies/README.md."""
    show_default(work, kinds, runs, write)
    columns = ["kind of data, scenes", "left out, training seeds", "left out, no images", "mean of models"]
    columns += ["left out - default", "left out - preset regions", "left out - best simple method"]
    rows = []
    for kind in kinds:
        files = sorted(work.glob(f"left-out-{kind}-[0-9]*.json"))
        of_mean = _read(work, [f"left-out-{kind}-mean{len(files)}"], runs)  # a mean of fewer seeds is another model
        found = _read(work, (f"default-{kind}", f"others-{kind}", *(file.stem for file in files)), runs)
        if not found or not files:
            continue
        default, others, *seeds = found
        left = np.concatenate([seed["learned, left out"] for seed in seeds])  # [seeds * runs, scenes, 2]
        blind = np.concatenate([seed["learned, left out, no images"] for seed in seeds])
        simple = others[max(SIMPLE, key=lambda name: float(others[name].mean()))]
        rivals = (default["default"], others["preset_regions"], simple)
        cells = [f"{TITLES.get(kind, kind)}, {left.shape[1]}", f"{_both(left)}, {len(seeds)}"]
        cells += [_both(blind), _both(of_mean[0]["learned, left out"]) if of_mean else "–"]
        rows.append([*cells, *(difference(left.mean(0) - rival.mean(0)) for rival in rivals)])
    if rows:
        report.show("domains", report.table(columns, rows), write)
    show_images(work, kinds, runs, write)


def show_default(work: Path, kinds: Sequence[str], runs: int, write: bool) -> None:
    """Prints the table of the default, presets and simple methods."""
    columns = ["kind of data, scenes", "default", *(f"preset {preset}" for preset in PRESETS), "best simple method"]
    columns += ["default - best preset", "default - best simple method", "with images - cloud alone"]
    rows = []
    for kind in kinds:
        found = _read(work, (f"default-{kind}", f"others-{kind}"), runs)
        if not found:
            continue
        own, others = found
        default, without = own.values()
        simple = max(SIMPLE, key=lambda name: float(others[name].mean()))
        preset = max((f"preset_{preset}" for preset in PRESETS), key=lambda name: float(others[name].mean()))
        cells = [f"{TITLES.get(kind, kind)}, {default.shape[1]}", _both(default)]
        cells += [*(_both(others[f"preset_{one}"]) for one in PRESETS), f"{_both(others[simple])} ({simple})"]
        rivals = (others[preset], others[simple], without)
        rows.append([*cells, *(difference((default - rival).mean(0)) for rival in rivals)])
    if not rows:
        return
    report.show("default", report.table(columns, rows), write)


def show_images(work: Path, kinds: Sequence[str], runs: int, write: bool) -> None:
    """Prints the table of the final images beside the initial ones, and of the points with and without images."""
    rows = []
    for kind in kinds:
        found = _read(work, (f"default-{kind}", f"images-{kind}"), runs)
        if not found:
            continue
        (with_images, without), (initial, final) = (scores.values() for scores in found)
        cells = [f"{TITLES.get(kind, kind)}, {initial.shape[1]}", _both(initial), _both(final)]
        rows.append([*cells, difference((final - initial).mean(0)), difference((with_images - without).mean(0))])
    if not rows:
        return
    columns = ["kind of data, scenes", "initial images", "final images", "final - initial"]
    report.show("images or not", report.table([*columns, "points: with images - cloud alone"], rows), write)


def _read(work: Path, names: Sequence[str], runs: int) -> list[dict[str, np.ndarray]]:
    """Of each file the scores [runs, scenes, 2] of its rows; nothing if one of the files is not there."""
    files = [work / f"{name}.json" for name in names]
    if not all(file.is_file() for file in files):
        return []
    # A file has the runs of the first scene, of the second, ...
    return [
        {row: np.array(scores).reshape(-1, runs, 2).transpose(1, 0, 2) for row, scores in json.loads(text).items()}
        for text in (file.read_text() for file in files)
    ]


def _both(scores: np.ndarray) -> str:
    """F / best IoU of [runs, scenes, 2]; with several runs, the standard deviation of the runs' means."""
    mean = scores.mean((0, 1))
    if len(scores) == 1:
        return f"{mean[0]:.3f} / {mean[1]:.3f}"
    spread = scores.mean(1).std(0, ddof=1)
    return f"{mean[0]:.3f} ± {spread[0]:.3f} / {mean[1]:.3f} ± {spread[1]:.3f}"


def difference(gain: np.ndarray) -> str:
    """Mean of differences [scenes, 2], paired by scene, with its standard error."""
    if len(gain) == 1:
        return f"{gain[0, 0]:+.3f} / {gain[0, 1]:+.3f}"
    error = gain.std(0, ddof=1) / len(gain) ** 0.5
    mean = gain.mean(0)
    return f"{mean[0]:+.3f} ± {error[0]:.3f} / {mean[1]:+.3f} ± {error[1]:.3f}"
