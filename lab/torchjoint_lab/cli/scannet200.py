"""torchjoint-lab scannet200: from ScanNet as it is downloaded, and masks as others publish them, to a row of a table.

The layouts of masks stand in :mod:`torchjoint_lab.datasets.published_masks`.
"""

from __future__ import annotations

import warnings
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import tyro
from tqdm import tqdm

from torchjoint.config import Config
from torchjoint.datasets import list_scenes, load_scene
from torchjoint.engine import open_engine
from torchjoint.masks.folder import frame_names
from torchjoint.metrics import ScannetAveragePrecisionMetric
from torchjoint.recordings import RecordingOptions, segment_recording
from torchjoint.runtime.files import write_text
from torchjoint_lab.cli.arguments import check_output
from torchjoint_lab.datasets.published_masks import masks_of
from torchjoint_lab.evaluation.predictions import read_prediction
from torchjoint_lab.evaluation.protocols import Name, counted, find_table

TABLE, ARGUMENTS = "table.md", "arguments.txt"


class Published(NamedTuple):
    """A row that others published, in per cent."""

    name: str
    source: str
    ap: tuple[float, float, float]


#: Class-agnostic AP, AP50, AP25 on the 312 validation scans, ScanNet200.
PUBLISHED = (
    Published("CDIS, masks of CropFormer", "its repository", (35.8, 54.6, 69.9)),
    Published("Open3DIS, masks of SAM", "its paper", (31.5, 45.3, 51.1)),
    Published("MaskClustering, masks of CropFormer", "Open3DIS' table", (17.4, 33.3, 46.7)),
    Published("OVIR-3D", "Open3DIS' table", (14.4, 27.5, 38.8)),
    Published("superpoints alone", "Open3DIS' table", (5.0, 12.7, 38.9)),
)


def scannet200(
    scans: tyro.conf.Positional[Path],
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    masks: Path | None = None,
    protocol: Name = "scannet200",
    label_table: Path | None = None,
    max_frames: int | None = None,
    engine: str | None = None,
    overwrite: bool = False,
) -> None:
    """Segments the annotated scans of ScanNet, scores them as its benchmark does, and writes a table.

    A run that was killed goes on when the same command is started again: scans with a result are only scored. A scan
    that fails stops no other.

    Args:
        scans: the folder of the data set, or its folder of scans, as downloaded.
        out: folder for a result of each scan, and table.md.
        masks: folder of masks, with a folder or a file for each scan, as MaskClustering, SAI3D, SAM3D or Open3DIS
            keeps them; None: no masks.
        protocol: the benchmark's classes.
        label_table: scannetv2-labels.combined.tsv; default: the one in SCANS, or in the two folders above.
        max_frames: number of frames of a scan, evenly spread; default: all.
        engine: workers for the frames: loky, dask or ray, as `torchjoint segment --engine`.
        overwrite: replace files in OUT that no earlier start has written.
    """
    table, found = label_table or find_table(scans, protocol), list_scenes(scans)
    written = check_output(out, (TABLE,), overwrite or (out / ARGUMENTS).is_file(), (masks, table))[TABLE]
    _check_arguments(out, f"--masks {masks and masks.resolve()} --max-frames {max_frames}", overwrite)
    metric, scored, failed = ScannetAveragePrecisionMetric(), 0, {}
    options = RecordingOptions(max_frames=max_frames)
    for name, path in tqdm(found.items(), desc="scans", unit="scan"):
        try:
            if not (out / name).is_dir():
                _segment(path, out / name, options, masks, engine)
            scene = load_scene(path)
            if scene.truth is None or scene.truth.points is None:
                raise ValueError(f"{name}: expected annotated vertices, got none")
            prediction = read_prediction(out / name, scene)
            if prediction.points is None:
                raise ValueError(f"{name}: expected a result with points")
            truth = counted(scene.truth.points, path, protocol, table)[prediction.of_points]
            metric.update(prediction.points, truth, prediction.scores)
            scored += 1
        except (ValueError, OSError) as error:
            failed[name] = str(error)
    if not scored:
        raise ValueError(f"{scans}: no scan was scored; the first error: {next(iter(failed.values()), 'none')}")
    text = _table(metric.compute(), scored, masks, protocol)
    text += "".join(f"\n{name} failed: {reason}" for name, reason in failed.items())
    with written.written() as path:
        write_text(path, f"{text}\n")
    print(text)


def _check_arguments(out: Path, arguments: str, overwrite: bool) -> None:
    """Raises ValueError if results in `out` are of a run with other arguments: a row would mix them."""
    out.mkdir(parents=True, exist_ok=True)
    file, has_results = out / ARGUMENTS, any(one.is_dir() for one in out.iterdir())
    before = file.read_text(encoding="utf-8", errors="replace") if file.is_file() else arguments
    if before != arguments and (has_results or not (overwrite or before.startswith("--masks "))):
        raise ValueError(f"-o: {out} is of a run with {before}; got {arguments}; choose another output")
    write_text(file, arguments)


def _segment(path: Path, out: Path, options: RecordingOptions, masks: Path | None, engine: str | None) -> None:
    with warnings.catch_warnings(), ExitStack() as stack:
        warnings.simplefilter("ignore", UserWarning)  # most frames have no masks: networks take every tenth
        without: Literal["segment", "leave-out"] = "segment" if masks is None else "leave-out"
        if masks is not None:
            masks = stack.enter_context(masks_of(masks, out.name, frame_names(load_scene(path).frames)))
        workers = None if engine is None else stack.enter_context(open_engine(engine, 1))
        segment_recording(path, out, Config(), options, masks=masks, without_masks=without, engine=workers)


def _table(ap: tuple[float, float, float], scans: int, masks: Path | None, protocol: Name) -> str:
    lines = ["| method | AP | AP50 | AP25 | from |", "|---|---:|---:|---:|---|"]
    given = "no masks" if masks is None else f"masks of {masks.name}"
    rows = [(f"torchjoint, {given}", [100 * one for one in ap], f"this run, {scans} scans, {protocol}")]
    if protocol == "scannet200":
        rows += [(one.name, list(one.ap), f"{one.source}, 312 scans") for one in PUBLISHED]
    lines += [f"| {name} | {a:.1f} | {b:.1f} | {c:.1f} | {source} |" for name, (a, b, c), source in rows]
    return "\n".join(lines)
