"""torchjoint-lab evaluate-boundaries: scores a boundary detector, or a folder of its predictions, on BSDS500."""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Literal

import torch
import tyro
from torch import Tensor

from torchjoint.config import DETECTORS, BoundaryConfig
from torchjoint.images.boundary import make_boundary
from torchjoint.runtime.outputs import Output
from torchjoint_lab.cli.arguments import check_output
from torchjoint_lab.datasets.boundary_maps import find_boundary_map, read_boundary_map
from torchjoint_lab.datasets.bsds import BsdsImage, bsds_images
from torchjoint_lab.evaluation.boundary_scores import BoundaryScores, evaluate_predictions
from torchjoint_lab.evaluation.region_scores import WITH_BOUNDARIES, WITHOUT_BOUNDARIES, RegionScores, evaluate_regions

FOREST = "structured_forest"
CURVE, PICTURE = "boundaries.csv", "precision_recall.png"


def evaluate_boundaries(
    boundaries: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="PRED_OR_DETECTOR")],
    bsds_dir: tyro.conf.Positional[Path],
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("boundary-scores"),
    split: Literal["train", "val", "test"] = "val",
    thresholds: int = 99,
    multi_scale: bool = False,
    nms: bool = True,
    regions: bool = True,
    overwrite: bool = False,
) -> None:
    """Scores boundaries on BSDS500: ODS, OIS, AP, and their benefit for the image segmentation.

    Args:
        boundaries: a detector, named as in parameter boundary.detector; or a structured forest's file NAME.yml.gz; or
            a folder of predictions: per image a NAME.png (grey, 8 or 16 bits) or a NAME.npy (floating point, in
            [0, 1]).
        bsds_dir: folder of the data set: images/ and groundTruth/, or the original BSR.
        out: folder for boundaries.csv (the precision-recall curve) and precision_recall.png.
        split: part of the data set.
        thresholds: number of thresholds; the protocol uses 99, fewer are faster.
        multi_scale: also detect at half and at twice the image size (structured forests only).
        nms: non-maximum suppression comes first, unless this is given: for predictions that are already thin.
        regions: the image segmentation with and without the boundaries is scored, too, unless this is given.
        overwrite: replace files in OUT.
    """
    files = check_output(out, (CURVE, PICTURE), overwrite, (Path(boundaries), bsds_dir))
    if multi_scale and not _is_forest(boundaries):
        raise ValueError(f"--multi-scale: only for structured forests, got {boundaries}")
    if boundaries == FOREST and split != "test":
        print(f"the package's forest was trained on train and val: its scores on {split} are too good")
    records = bsds_images(bsds_dir, split)
    predict = _predictor(boundaries, records, multi_scale)
    scores = evaluate_predictions(predict, records, thresholds, nms=nms, progress=True)
    out.mkdir(parents=True, exist_ok=True)
    _write(files, scores, boundaries)
    print(_boundary_table(scores))
    if regions:
        settings = {"with boundaries": WITH_BOUNDARIES, "without": WITHOUT_BOUNDARIES}
        found = evaluate_regions(predict, records, list(settings.values()), progress=True)
        print(_region_table(dict(zip(settings, found, strict=True))))
    print(f"written to {out}: {CURVE}, {PICTURE}")


def _predictor(boundaries: str, records: Sequence[BsdsImage], multi_scale: bool) -> Callable[[BsdsImage], Tensor]:
    if boundaries not in DETECTORS and Path(boundaries).is_dir():
        files = {record.name: find_boundary_map(Path(boundaries), record.name) for record in records}
        for record in records:  # an error in the last file should be reported before minutes of scoring
            _checked_map(files[record.name], record)
        return lambda record: _checked_map(files[record.name], record)
    detector, model = (FOREST, boundaries) if boundaries.endswith(".yml.gz") else (boundaries, None)
    try:
        module = make_boundary(BoundaryConfig(detector, model, multi_scale), allow_import=True)
    except (ValueError, OSError) as error:
        raise ValueError(
            f"{boundaries}: neither a folder of predictions, nor a forest, nor a detector: {error}"
        ) from error
    return lambda record: module(record.image[None])[0]


def _is_forest(boundaries: str) -> bool:
    return boundaries == FOREST or boundaries.endswith(".yml.gz")


def _checked_map(file: Path, record: BsdsImage) -> Tensor:
    pred, size = read_boundary_map(file), record.image.shape[1:]
    if pred.shape != size:
        raise ValueError(f"{file}: expected the image's size, {list(size)} (rows, columns), got {list(pred.shape)}")
    return pred


def _boundary_table(scores: BoundaryScores) -> str:
    return (
        "boundaries          ODS     at precision recall    OIS     AP\n"
        f"{'':16} {scores.ods:6.3f} {scores.ods_threshold:6.2f} {scores.ods_precision:9.3f} {scores.ods_recall:6.3f} "
        f"{scores.ois:6.3f} {scores.ap:6.3f}"
    )


def _region_table(rows: dict[str, RegionScores]) -> str:
    lines = ["regions          covering symmetric F objects and parts  segments"]
    for name, row in rows.items():
        lines.append(
            f"{name:16} {row.covering:8.3f} {row.symmetric_covering:9.3f} {row.f:19.3f} {row.num_segments:9.0f}"
        )
    return "\n".join(lines)


def _write(files: Mapping[str, Output], scores: BoundaryScores, name: str) -> None:
    with files[CURVE].written() as partial, partial.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(scores.curve._fields)
        writer.writerows([f"{value:.6f}" for value in row] for row in torch.stack(list(scores.curve), 1).tolist())
    with files[PICTURE].written() as partial:
        _draw(partial, scores, name)


def _draw(path: Path, scores: BoundaryScores, name: str) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.5, 5.5), layout="constrained")
    axes = figure.subplots()
    for f in torch.arange(1, 10) / 10:
        recall = torch.linspace(float(f) / (2 - float(f)), 1, 200)
        axes.plot(recall, f * recall / (2 * recall - f), color="0.85", linewidth=0.8)  # the curve of constant F = f
        axes.annotate(f"F = {f:.1f}", (1, float(f / (2 - f))), color="0.6", fontsize=7, ha="right")
    shown = (scores.curve.recall + scores.curve.precision) > 0  # without a prediction, precision is undefined
    axes.plot(scores.curve.recall[shown], scores.curve.precision[shown], color="tab:blue", marker=".", markersize=3)
    label = f"ODS {scores.ods:.3f} at {scores.ods_threshold:.2f}"
    axes.plot(scores.ods_recall, scores.ods_precision, "o", color="tab:red", clip_on=False, label=label)
    axes.set(xlim=(0, 1), ylim=(0, 1), xlabel="recall", ylabel="precision", aspect="equal")
    name = name.replace("$", r"\$")
    axes.set_title(f"{name}: OIS {scores.ois:.3f}, AP {scores.ap:.3f}", fontsize=10)
    axes.legend(loc="lower left")
    figure.savefig(path, dpi=120)
