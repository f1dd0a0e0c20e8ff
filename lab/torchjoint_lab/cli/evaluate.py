"""torchjoint-lab evaluate: scores results against ground truth."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import tyro
from tqdm import tqdm

from torchjoint.datasets import list_scenes, load_scene
from torchjoint.runtime.foreign_files import has_file, is_there
from torchjoint.runtime.messages import say
from torchjoint.runtime.outputs import Output
from torchjoint.scene import Scene, Truth
from torchjoint_lab.cli.arguments import check_output
from torchjoint_lab.evaluation.evaluate import evaluate as evaluate_prediction
from torchjoint_lab.evaluation.evaluate import evaluate_levels, left_out
from torchjoint_lab.evaluation.levels import level_table, write_levels
from torchjoint_lab.evaluation.partial_truth import knows
from torchjoint_lab.evaluation.predictions import Prediction, is_result, read_prediction
from torchjoint_lab.evaluation.protocols import Name, counted, find_table
from torchjoint_lab.evaluation.scores import Scores
from torchjoint_lab.evaluation.table import Row, scene_table, write_csv, write_plot

TABLE, PICTURE, LEVELS = "scores.csv", "scores.png", "levels.csv"


def evaluate(
    pred: tyro.conf.Positional[Path],
    scene: tyro.conf.Positional[Path],
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None,
    protocol: Annotated[Name | None, tyro.conf.arg(constructor=Name, help_behavior_hint="")] = None,
    label_table: Path | None = None,
    voxel_size: float = 0.02,
    overwrite: bool = False,
) -> None:
    """Scores results against the ground truth of one scene, or of all scenes of a data set.

    If all results have a hierarchy (method learned), all their levels are also scored.

    Args:
        pred: a folder written by `torchjoint segment`; or point labels, .npy or .txt, in the order of SCENE's cloud,
            which cannot be checked; or instances as in ScanNet's benchmark, in this order, .txt with predicted_masks/,
            or .npz with pred_masks; or, for a data set, a folder of such folders or files, named like the scenes.
        scene: a scene with ground truth, or a data set of such scenes; docs/your_data.md lists the layouts.
        protocol: for scans of ScanNet or ScanNet++: which true instances count, those of the 18 classes of ScanNet v2,
            of the 198 of ScanNet200, or of the 84 of ScanNet++; all others are void. Classes are not compared.
        label_table: scannetv2-labels.combined.tsv, or metadata/semantic_benchmark/map_benchmark.csv of ScanNet++;
            default: the one in SCENE, or in the two folders above.
        out: folder for scores.csv and scores.png, and for levels.csv if there are levels.
        voxel_size: metres, for fusing a cloud from depth; used only if PRED does not hold the cloud.
        overwrite: replace files in OUT.
    """
    files = None if out is None else check_output(out, (TABLE, PICTURE, LEVELS), overwrite, (pred, scene, label_table))
    if protocol is None and label_table is not None:
        raise ValueError("--label-table: expected a --protocol, too")
    table = (label_table or find_table(scene, protocol)) if protocol is not None else None
    scenes = list_scenes(scene)
    scored = _ScoreCollector()
    try:
        for name, path in tqdm(scenes.items(), desc="scenes", unit="scene", disable=len(scenes) == 1):
            found = pred if is_result(pred) and len(scenes) == 1 else _of_scene(pred, name)
            loaded = load_scene(path, cloud=_kept_cloud(found, voxel_size), voxel_size=voxel_size)
            if protocol is not None and table is not None and loaded.truth is not None:
                loaded = _with_truth_of(protocol, loaded, path, table)
            if len(scenes) > 1 and not (loaded.truth and knows(loaded.truth)):
                scored.notes.append(f"{name}: has no ground truth and is left out")
            else:
                scored.add(name, loaded, read_prediction(found, loaded))
    finally:  # also reports the scores from before an error
        scored.report(out, files)


class _ScoreCollector:
    """Collects the scores of scenes, and reports them."""

    def __init__(self) -> None:
        from torchjoint.metrics import ScannetAveragePrecisionMetric  # torchmetrics takes a second to import

        self.rows: list[Row] = []
        self.notes: list[str] = []
        self.levels: dict[str, list[Scores]] = {}
        self.instances = ScannetAveragePrecisionMetric()

    def add(self, name: str, scene: Scene, prediction: Prediction) -> None:
        self.rows += evaluate_prediction(prediction, scene, name)
        if of_levels := evaluate_levels(prediction, scene):
            self.levels[name] = of_levels
        if partial := left_out(prediction, scene):
            self.notes.append(f"{name}: the result has only {partial}; these are scored")
        truth = scene.truth.points if scene.truth is not None else None
        if prediction.points is not None and truth is not None:
            found = prediction.points if prediction.instances is None else prediction.instances.points
            self.instances.update(found, truth[prediction.of_points], prediction.scores)

    def report(self, out: Path | None, files: Mapping[str, Output] | None) -> None:
        if not self.rows:
            return
        say(scene_table(self.rows))
        average = self.instances.compute() if self.instances.update_called else None
        if average is not None and not math.isnan(average.ap):
            ap, ap50, ap25 = average
            say(f"ScanNet's class-agnostic AP {ap:.3f}, AP50 {ap50:.3f}, AP25 {ap25:.3f}: 3D, all scenes together")
        in_3d = {row.scene for row in self.rows if row.space == "3D"}
        if self.levels and set(self.levels) == in_3d:
            say(level_table(self.levels))
        elif self.levels:
            self.notes.append(f"only {len(self.levels)} of {len(in_3d)} results have levels: no scores of all levels")
        for note in self.notes:
            say(note)
        if out is not None and files is not None:
            out.mkdir(parents=True, exist_ok=True)
            with files[TABLE].written() as path:
                write_csv(path, self.rows)
            with files[PICTURE].written() as path:
                write_plot(path, self.rows)
            if self.levels:
                with files[LEVELS].written() as path:
                    write_levels(path, self.levels)
            else:
                files[LEVELS].remove()
            say(f"written to {out}: {TABLE}, {PICTURE}{', ' + LEVELS if self.levels else ''}")


def _of_scene(pred: Path, name: str) -> Path:
    found = [one for suffix in ("", ".npy", ".txt", ".npz") if is_there(one := pred / f"{name}{suffix}")]
    if not found:
        raise FileNotFoundError(f"{pred / name}: missing; expected a result (or {name}.npy, .txt, .npz) for each scene")
    if len(found) > 1:
        raise ValueError(f"{pred}: expected one prediction of {name}, got {', '.join(one.name for one in found)}")
    return found[0]


def _with_truth_of(protocol: Name, scene: Scene, path: Path, table: Path) -> Scene:
    """The scene with the instances of the cloud that the protocol counts; images are not scored."""
    if scene.truth is None or scene.truth.points is None:
        raise ValueError(f"--protocol {protocol}: expected a scan of the data set with annotated vertices, got {path}")
    return replace(scene, truth=Truth(counted(scene.truth.points, path, protocol, table)))


def _kept_cloud(result: Path, voxel_size: float) -> Path | None:
    kept = result / f"cloud-{voxel_size * 1000:g}mm.ply"
    return kept if has_file(kept) else None
