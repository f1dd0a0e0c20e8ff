"""torchjoint-lab paper-tables: reproduces the paper's two tables from labelled scenes and results of the baselines."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import torch
import tyro
from torch import Tensor

from torchjoint.cli.arguments import DEFAULTS, Flat, Out
from torchjoint.datasets.cameras import resize_nearest
from torchjoint.images.segmenter import ImageSegmenter
from torchjoint.joint import JointSegmenter
from torchjoint.results.folder import read_origin
from torchjoint.runtime.files import write_text
from torchjoint.runtime.messages import Stopwatch
from torchjoint.runtime.outputs import Output
from torchjoint.runtime.threads import LazySequence, one_thread_per_operation
from torchjoint.scene import Scene, Truth
from torchjoint_lab.cli.arguments import check_max_frames, check_output
from torchjoint_lab.datasets.scenes import list_scenes, load_scene
from torchjoint_lab.datasets.sis3d import GRID, find_folders
from torchjoint_lab.datasets.voxels import read_world_to_scene
from torchjoint_lab.evaluation.baselines.scenecut import find_region_map, read_region_map
from torchjoint_lab.evaluation.baselines.sis3d import detection_labels, read_detections
from torchjoint_lab.evaluation.paper_tables import (
    ROWS,
    LabelImages,
    Row,
    Scores,
    comparable,
    mean_scores,
    paper_table,
    score_images,
    score_points,
)
from torchjoint_lab.evaluation.predictions import Prediction, read_prediction

TABLES, MEANS, SCENES = "tables.md", "tables.csv", "scenes.csv"

#: Largest relative difference between the aspect ratios of a region map and its image; resolutions may differ.
_SHAPE_TOLERANCE = 0.02


def paper_tables(
    scenes: tyro.conf.Positional[Path],
    out: Out,
    sis3d: Path | None = None,
    scenecut: Path | None = None,
    results: Path | None = None,
    max_frames: int = 50,
    parameters: Flat = DEFAULTS,
    overwrite: bool = False,
) -> None:
    """Scores our results and the baselines' results on labelled scenes: the paper's tables I and II.

    Args:
        scenes: folder of scenes, of ScanNet or of 3D-SIS' examples; or one scene.
        out: folder for tables.md, tables.csv, and scenes.csv with the rows of each scene.
        sis3d: results of 3D-SIS, a folder SCAN/ per scene; may also hold the scene's world2grid.txt, which is needed if
            the scene itself has none.
        scenecut: results of SceneCut, a folder SCAN/ per scene with a NAME.mat or NAME.npy per frame.
        results: folders SCAN/ written by `torchjoint segment`; they are scored, and no scene is segmented again.
        max_frames: number of frames per scene to segment, evenly spread.
        parameters: parameters of the method.
        overwrite: replace files in OUT.
    """
    files = check_output(out, (TABLES, MEANS, SCENES), overwrite, (scenes, sis3d, scenecut, results))
    check_max_frames(max_frames)
    for folder in (sis3d, scenecut, results):
        if folder is not None and not folder.is_dir():
            raise FileNotFoundError(f"{folder}: no such folder; expected results in it, a folder for each scene")
    sources = _Sources(sis3d, scenecut, results, max_frames, JointSegmenter(parameters.config(), allow_import=True))
    paths = list_scenes(scenes)
    found: dict[str, dict[Row, Scores]] = {}
    try:
        for number, path in enumerate(paths.values(), 1):
            scene = load_scene(path, progress=True)
            print(f"scene {number} of {len(paths)}: {scene.name}")
            found[scene.name] = sources.score(scene, path)
    finally:  # scores from before an error are not lost
        if any(found.values()):
            out.mkdir(parents=True, exist_ok=True)
            print(f"\n{_write(files, found, sources.notes)}\nwritten to {out}: {TABLES}, {MEANS}, {SCENES}")
    if not any(found.values()):
        raise ValueError(f"{scenes}: none of its {len(paths)} scenes has a truth to compare with")


@dataclass(frozen=True)
class _Sources:
    """The sources of the segmentations: our method and the baselines' results."""

    sis3d: Path | None
    scenecut: Path | None
    results: Path | None
    max_frames: int
    segmenter: JointSegmenter
    notes: list[str] = field(default_factory=list)  #: notes about scenes and results that were left out

    def score(self, scene: Scene, path: Path) -> dict[Row, Scores]:
        """Returns the rows of one scene; the baselines' files are checked first, since our method takes long."""
        if scene.truth is None:
            self.notes.append(f"{scene.name}: has no ground truth and is left out")
            return {}
        detected = self._detected(scene, path)
        result = self._folder(self.results, scene.name, "result of `torchjoint segment`; the scene is segmented again")
        if result is not None:
            ours = read_prediction(result, scene)
            scene = scene.select_frames(ours.of_frames)
            maps = self._region_maps(scene)
            initial: Sequence[Tensor] = _initial_segmentation(result, scene)
        else:
            scene = scene.sample_frames(self.max_frames)
            maps = self._region_maps(scene)
            made = self.segmenter(scene, progress=True)
            ours = Prediction(made.points, torch.arange(len(made.points)), made.images, range(len(made.images)))
            initial = made.initial_images
        methods: dict[str, LabelImages] = {"initial": lambda i, _: initial[i], "final": lambda i, _: ours.images[i]}
        methods |= {} if maps is None else {"SceneCut": maps}
        truth = scene.truth or Truth()
        rows = score_images(methods, truth.images, progress=True)
        if truth.points is not None and ours.points is not None:
            of = ours.of_points
            rows |= score_points(ours.points, truth.points[of], None if detected is None else detected[of])
        return rows

    def _detected(self, scene: Scene, path: Path) -> Tensor | None:
        folder = self._folder(self.sis3d, scene.name, "result of 3D-SIS")
        if folder is None:
            return None
        own = find_folders(path)
        grids = [folder / GRID, *([own.images / GRID] if own is not None else [])]
        grid = next((file for file in grids if file.is_file()), grids[0])
        return detection_labels(read_detections(folder), scene.points, read_world_to_scene(grid))

    def _region_maps(self, scene: Scene) -> LabelImages | None:
        folder = self._folder(self.scenecut, scene.name, "result of SceneCut")
        if folder is None:
            return None
        files = [find_region_map(folder, frame.name) for frame in scene.frames]
        return lambda i, size: _fitted(read_region_map(files[i]), size, files[i])

    def _folder(self, root: Path | None, name: str, what: str) -> Path | None:
        if root is None:
            return None
        if not (root / name).is_dir():
            self.notes.append(f"{name}: no {what}")
            return None
        return root / name


def _initial_segmentation(result: Path, scene: Scene) -> LazySequence[Tensor]:
    """The initial image segmentation of a result, computed again: a result does not store it."""
    segment = ImageSegmenter(read_origin(result).config)

    def initial(i: int) -> Tensor:
        with one_thread_per_operation():
            return segment([scene.frames[i]], Stopwatch())[0].labels

    return LazySequence(len(scene.frames), initial)


def _fitted(labels: Tensor, size: tuple[int, int], file: Path) -> Tensor:
    shape = labels.shape[1] / labels.shape[0] * size[0] / size[1]
    if abs(shape - 1) > _SHAPE_TOLERANCE:
        raise ValueError(
            f"{file}: expected a map of the image's shape, {size[0]} x {size[1]} (rows, columns), got "
            f"{labels.shape[0]} x {labels.shape[1]}"
        )
    return resize_nearest(labels, size)


def _write(files: Mapping[str, Output], found: Mapping[str, Mapping[Row, Scores]], notes: Sequence[str]) -> str:
    """Writes the three files; returns the tables."""
    rows = comparable(found)
    partial = [
        f"{row.method} on {row.on}: {total} scenes, of which {len(rows[row])} have all rows and are shown"
        for row in rows
        if (total := sum(row in scores for scores in found.values())) > len(rows[row])
    ]
    missing = [f"{row.method} on {row.on}: nothing to score; the row is left out" for row in ROWS if row not in rows]
    means = [[*row, len(scores), *_rounded(mean_scores(scores))] for row, scores in rows.items()]
    singles = [[name, *row, *_rounded(scores[row])] for name, scores in found.items() for row in ROWS if row in scores]
    remarks = "\n".join(f"- {note}" for note in (*notes, *partial, *missing))
    text = "\n\n".join(part for part in (paper_table(rows, "I"), paper_table(rows, "II"), remarks) if part) + "\n"
    texts = {
        SCENES: _csv(("scene", *Row._fields, *Scores._fields), singles),
        MEANS: _csv((*Row._fields, "scenes", *Scores._fields), means),
        TABLES: text,
    }
    for name, content in texts.items():
        with files[name].written() as path:
            write_text(path, content)
    return text


def _rounded(scores: Scores) -> list[str]:
    return [f"{value:.6f}" for value in scores]


def _csv(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    stream = io.StringIO()
    csv.writer(stream, lineterminator="\n").writerows([header, *rows])
    return stream.getvalue()
