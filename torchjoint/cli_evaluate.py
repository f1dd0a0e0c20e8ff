"""torchjoint evaluate: results against truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro
from tqdm import tqdm

from torchjoint.datasets import list_scenes, load_scene
from torchjoint.evaluation.evaluate import evaluate as evaluate_prediction
from torchjoint.evaluation.predictions import is_result, read_prediction
from torchjoint.evaluation.table import Row, scene_table, write_csv, write_plot

TABLE, PICTURE = "scores.csv", "scores.png"


def evaluate(
    pred: tyro.conf.Positional[Path],
    scene: tyro.conf.Positional[Path],
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None,
    voxel_size: float = 0.02,
) -> None:
    """Scores results against the truth of one scene, or of a data set's scenes.

    Args:
        pred: a folder that `torchjoint segment` wrote; or labels of the points, .npy or .txt; or, for a data set, a
            folder of these, named as its scenes.
        scene: a scene with truth, or a data set of such; see the README for the layouts that are known.
        out: folder for scores.csv and scores.png.
        voxel_size: metres, of a cloud that is fused from depth; used where PRED does not keep the cloud itself.
    """
    from torchjoint.metrics import ScannetAveragePrecisionMetric  # torchmetrics takes a second to import

    scenes = list_scenes(scene)
    if not scenes:
        load_scene(scene)  # says what was looked for
    rows: list[Row] = []
    instances = ScannetAveragePrecisionMetric()
    for name, path in tqdm(scenes.items(), desc="scenes", unit="scene", disable=len(scenes) == 1):
        found = pred if is_result(pred) and len(scenes) == 1 else _of_scene(pred, name)
        loaded = load_scene(path, cloud=_kept_cloud(found, voxel_size), voxel_size=voxel_size)
        prediction = read_prediction(found, loaded)
        rows += evaluate_prediction(prediction, loaded, name)
        if prediction.points is not None and loaded.truth is not None and loaded.truth.points is not None:
            instances.update(prediction.points, loaded.truth.points[prediction.of_points])
    print(scene_table(rows))
    if instances.update_called:
        ap, ap50, ap25 = instances.compute()
        print(f"ScanNet's class-agnostic AP {ap:.3f}, AP50 {ap50:.3f}, AP25 {ap25:.3f} in 3D, over all scenes together")
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        write_csv(out / TABLE, rows)
        write_plot(out / PICTURE, rows)
        print(f"written to {out}: {TABLE}, {PICTURE}")


def _of_scene(pred: Path, name: str) -> Path:
    for candidate in (pred / name, pred / f"{name}.npy", pred / f"{name}.txt"):
        if candidate.exists():
            return candidate
    raise FileNotFoundError(f"{pred / name}: missing; expected a result (or {name}.npy, {name}.txt) for each scene")


def _kept_cloud(result: Path, voxel_size: float) -> Path | None:
    kept = result / f"cloud-{voxel_size * 1000:g}mm.ply"
    return kept if kept.is_file() else None
