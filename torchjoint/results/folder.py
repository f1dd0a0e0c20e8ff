"""A result on disk (output after step 8): the folder that `torchjoint segment` writes and `torchjoint show` reads."""

import os
import platform
import shutil
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import fields, replace
from fnmatch import fnmatch
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
import torch
import yaml
from PIL import Image
from torch import Tensor
from tqdm import tqdm

from torchjoint.config import Config, read_yaml
from torchjoint.datasets.files.ply import write_cloud
from torchjoint.datasets.files.readers import read_label_image
from torchjoint.results import manifest
from torchjoint.results.edits import FILE as EDITS
from torchjoint.results.edits import read_edits
from torchjoint.results.embeddings import read_embeddings
from torchjoint.results.figures import overview
from torchjoint.results.inputs import CAMERAS, read_inputs, read_names, write_inputs
from torchjoint.results.mask_report import frames_with_masks, names_of_masks
from torchjoint.results.objects import write_segments
from torchjoint.results.parts import Parts, edited
from torchjoint.results.render import label_colors
from torchjoint.results.result import Result
from torchjoint.results.upright import up_direction
from torchjoint.runtime.archives import read_archive
from torchjoint.runtime.files import frame_files
from torchjoint.runtime.foreign_files import damage_is, has_file, no_twice, present
from torchjoint.runtime.messages import printable
from torchjoint.runtime.store import pack
from torchjoint.runtime.threads import LazySequence, on_cpu, parallel_map
from torchjoint.scene import Cloud, LabelImages, Scene, Segmentation
from torchjoint.scene.checks import as_labels

T = TypeVar("T")
#: Largest label in a 16-bit label image, which stores label + 1; 0 = none.
MAX_LABEL = 2**16 - 2


#: All files and folders of a result.
PARTS = (
    *("points.ply", "points.npz", "cloud-*mm.ply", "hierarchy.npz", "embeddings.npz", "overview.png", "run.yaml"),
    *("cameras.json", "segments.json", "masks.json", "edits.json", "manifest.json"),
    *("images", "images_color", "inputs", "pieces"),
)


def parts_of(result: Path) -> list[Path]:
    """What no output of a command may replace: a result, and the file that was segmented; of a file, the file.

    Other files in a result's folder are not of the result.
    """
    if result.is_file():
        return [result]
    source = read_origin(result).scene
    own = [path for part in PARTS for path in result.glob(part)]
    return [*own, Path(source)] if os.path.isfile(source) else own


def is_part(path: Path) -> bool:
    """Whether a path is that of a part of a result, also of one that is not there, or is in one."""
    real = path.parent.resolve() / path.name.lower()
    named = (one.parent for one in (real, *real.parents) if any(fnmatch(one.name, part) for part in PARTS))
    return any((folder / "run.yaml").is_file() and (folder / "points.npz").is_file() for folder in named)


class PointResult(NamedTuple):
    """The arrays of `points.npz`."""

    points: Tensor  #: [N, 3] float32 metres
    labels: Tensor  #: [N] int64
    colors: Tensor | None  #: [N, 3] float32


class Origin(NamedTuple):
    """What a result was made from."""

    scene: str  #: the recording's path
    fingerprint: str | None  #: of its files; None in results of version 0.1.0
    version: str  #: of this package
    config: Config
    made: dict[str, Any]  #: the options, models and masks; empty in results of `live`


@on_cpu()
def write_result(
    folder: Path,
    scene: Scene,
    result: Segmentation,
    config: Config,
    source: str,
    granularity: float | None = 0.5,
    *,
    made: Mapping[str, Any] | None = None,
    seconds: Mapping[str, float] | None = None,
    progress: bool = False,
) -> None:
    """Writes points.ply, points.npz, segments.json, images/NAME.png, overview.png and run.yaml into a folder.

    The frames are written, too: cameras.json, inputs/NAME.jpg, and images_color/NAME.jpg with the labels over them.
    A result with a hierarchy also gets hierarchy.npz and pieces/NAME.png, from which any level can be computed. Then
    run.yaml also records the granularity of the labels, the values of `made`, and the wall-clock `seconds` of the run's
    parts before, with those of writing. manifest.json has the checksums.
    """
    start, bar = time.perf_counter(), tqdm(total=5, desc="write", unit="part", disable=not progress)
    # The parts of an interrupted run go: with other parameters it may have written other files.
    for path in (folder / part for part in PARTS if part != EDITS):  # a fused cloud's name is a pattern: it stays
        shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
    # Each part below uses all label images: they are computed once, and kept packed.
    packed = parallel_map(lambda index: pack(result.images[index]), range(len(result.images)))
    names = tuple(name or file for name, file in zip(result.names, frame_files(result.names), strict=True))
    result, scene = replace(result, images=LabelImages(packed), names=names).labelled(scene)
    write_cloud(folder / "points.ply", scene.points, label_colors(result.points), result.points)
    bar.update()
    arrays = {"points": scene.points, "labels": result.points, "colors": scene.colors}
    stored = {key: value.numpy() for key, value in arrays.items() if value is not None}
    np.savez_compressed(folder / "points.npz", **stored)  # type: ignore[arg-type]
    bar.update()
    last_label = _write_label_images(folder / "images", result)
    if result.hierarchy is not None:
        manifest.write_hierarchy(folder, result.hierarchy, frame_files(result.names), result.superpoint_images)
    write_inputs(folder, scene, result)
    bar.update()
    scene = replace(scene, up=up_direction(scene))
    if len(scene.frames):
        scene = replace(scene, frames=read_inputs(folder, result.names))  # faster to read than the recording
    write_segments(folder, scene, result, names_of_masks(folder) | dict((made or {}).get("names", {})))
    bar.update()
    picture = overview(scene, result, names=frames_with_masks(folder))
    picture.savefig(folder / "overview.png", dpi=100, pil_kwargs=manifest.PNG)
    record = _run_record(scene, result, config, source, granularity, last_label) | dict(made or {})
    manifest.write_manifest(folder, record)
    bar.update()
    bar.close()
    parts = dict(seconds or {}) | {"write": time.perf_counter() - start}
    record["seconds"] = {part: round(value, 3) for part, value in parts.items()}
    (folder / "run.yaml").write_text(yaml.safe_dump(record, sort_keys=False))


def read_points(folder: Path) -> PointResult:
    """Reads `points.npz` of a result."""
    file = folder / "points.npz"
    present(file, "a folder that `torchjoint segment` wrote")
    with damage_is(f"{file}: not a whole result", OSError):
        values = {key: torch.from_numpy(array) for key, array in read_archive(file).items()}
        cloud = Cloud.checked(values["points"], values.get("colors"), None)
        labels = as_labels(values["labels"], (len(cloud.points),))
        if not 0 <= int(labels.min()) <= int(labels.max()) < len(labels):
            raise ValueError(f"labels: expected 0 to {len(labels) - 1}, got {int(labels.min())} to {int(labels.max())}")
        return PointResult(cloud.points, labels, cloud.colors)


def read_result(folder: Path, labels: Tensor | None = None, check: manifest.Check = manifest.unchecked) -> Segmentation:
    """Reads a result, with all its levels if it has a hierarchy.

    Images are read, and checked, when they are used. Images and names are in the order of the names; initial images are
    not kept. `labels`: of the points, if they were read before.
    """
    labels = read_points(folder).labels if labels is None else labels
    files = sorted(file for file in (folder / "images").glob("*.png") if file.name[:2] != "._")
    images = LazySequence(len(files), lambda index: read_label_image(check(files[index])) - 1)
    true = {file: name for name, file in read_names(folder).items()}
    names = tuple(true.get(file.stem, file.stem) for file in files)
    if not has_file(folder / manifest.HIERARCHY):
        return Segmentation(labels, images, names=names)
    hierarchy = manifest.read_hierarchy(folder, len(labels))
    of_superpoint = torch.zeros(hierarchy.num_superpoints, dtype=torch.int64)
    of_superpoint[hierarchy.superpoint] = labels
    if not torch.equal(of_superpoint[hierarchy.superpoint], labels):
        file = folder / manifest.HIERARCHY
        raise ValueError(f"{file}: expected superpoints inside one segment of points.npz, got others")

    def superpoints(index: int) -> Tensor:
        file = folder / manifest.SUPERPOINTS / files[index].name
        return manifest.read_superpoint_image(check(file), hierarchy.num_superpoints)

    superpoint_images = LazySequence(len(files), superpoints)
    return Segmentation(labels, images, names=names, hierarchy=hierarchy, superpoint_images=superpoint_images)


def read_run(folder: Path, parse: Callable[[Any], T]) -> T:
    """Reads run.yaml of a result.

    Args:
        folder: the result.
        parse: makes a value of the file's content; an error of it is one of the file.

    Raises:
        FileNotFoundError, ValueError: it is missing, or no record of a run; the message names the file.
    """
    file = present(folder / "run.yaml", "a folder that `torchjoint segment` wrote")
    return read_yaml(file, parse, "a record of a run")


def read_origin(folder: Path) -> Origin:
    """Reads what a result was made from."""

    def origin(record: Any) -> Origin:
        scene, known = os.path.abspath(str(record["scene"])), record.get("fingerprint")
        made = {name: record[name] for name in ("options", "models", "masks") if name in record}
        return Origin(scene, known, record["versions"]["torchjoint"], Config.from_dict(record["config"]), made)

    return read_run(folder, origin)


def read_granularity(folder: Path) -> float | None:
    """Reads the level of a result's labels; None if it has no levels."""
    return read_run(folder, lambda record: None if (level := record.get("granularity")) is None else float(level))


def read_record(folder: Path) -> tuple[dict[str, int], dict[str, float]]:
    """Reads a result's counts (points, frames, point_segments) and the seconds of its parts."""

    def numbers(record: Any) -> tuple[dict[str, int], dict[str, float]]:
        counts = {name: int(record["counts"][name]) for name in ("points", "frames", "point_segments")}
        return counts, {str(part): float(value) for part, value in record["seconds"].items()}

    return read_run(folder, numbers)


def _write_label_images(folder: Path, result: Segmentation) -> int:
    """Writes the label images; returns the largest label, or -1."""
    names = frame_files(result.names)
    no_twice(names, "frames: name")
    folder.mkdir()

    def write(index: int) -> int:
        labels = result.images[index]
        if (last := int(labels.max())) > MAX_LABEL:
            told = f"image segments: ids up to {last} do not fit 16-bit images (at most {MAX_LABEL})"
            raise ValueError(f"{told}; raise image_segments.min_size, or choose a lower granularity")
        Image.fromarray((labels + 1).numpy().astype(np.uint16)).save(folder / f"{names[index]}.png", **manifest.PNG)
        return last

    return max(parallel_map(write, range(len(names))), default=-1)


def _run_record(
    scene: Scene, result: Segmentation, config: Config, source: str, granularity: float | None, last_label: int
) -> dict[str, Any]:
    packages = ("torchjoint", "torch", "kornia", "numpy", "scipy", "open3d", "opencv-contrib-python-headless")
    versions = {"python": platform.python_version()}
    for name in packages:
        with suppress(PackageNotFoundError):  # a package may be optional
            versions[name] = version(name)
    return {
        "scene": os.path.abspath(source),  # a relative one would be another file in another folder
        "up": [round(value, 6) + 0.0 for value in up_direction(scene).tolist()],
        **({} if result.hierarchy is None else {"granularity": granularity}),
        "counts": {
            "points": len(scene.points),
            "frames": len(result.images),
            "point_segments": result.num_point_segments,
            "image_segments_without_points": max(0, last_label + 1 - result.num_point_segments),
        },
        "thread_seconds": {stage: round(seconds, 3) for stage, seconds in result.seconds.items()},
        "versions": versions,
        "config": config.to_dict(),
        "manifest": manifest.FILE,
    }


@on_cpu()
def load_result(folder: str | Path, *, edits: bool = True, verify: bool = True) -> Result:
    """Reads a folder that ``torchjoint segment`` wrote: labels, all levels, the cloud, cameras and parameters.

    :attr:`Result.embeddings <torchjoint.results.result.Result.embeddings>` are those that were saved with it.

    Images and frames are read when they are used, in the order of their names. Frames have the images as they were
    saved, in JPEG. A result of an earlier version has no frames.

    The files must be those that the run wrote: manifest.json has their checksums. Images are compared when they are
    read.

    Args:
        folder: the result.
        edits: apply the corrections of edits.json, if there are any; all other segments keep their ids. Levels from
            :meth:`~torchjoint.Segmentation.at` do not contain the corrections.
        verify: False: also read a result whose files were changed, lost or exchanged after the run.

    Raises:
        FileNotFoundError: a file is missing.
        ValueError, TypeError: a file is damaged or of another result; the message names it.

    Example::

        result = load_result("out/")
        result.images[0], result.at(0.3), result.crops(7, k=3)[0].image
    """
    folder = Path(folder)
    of = manifest.manifest_checksum(folder)
    stored, config = read_points(folder), read_origin(folder).config
    check = manifest.open_manifest(folder) if verify else manifest.unchecked
    segmentation = read_result(folder, stored.labels, check)
    if verify:
        _check_counts(folder, segmentation)
    frames = read_inputs(folder, segmentation.names, check) if has_file(folder / CAMERAS) else ()
    up = read_run(folder, lambda record: record.get("up"))  # results of earlier versions have none
    up = None if up is None else torch.tensor(up, dtype=torch.float64)
    scene = Scene(stored.points, frames, stored.colors, name=folder.resolve().name, up=up)
    values = {one.name: getattr(segmentation, one.name) for one in fields(Segmentation)}
    given = read_run(folder, lambda run: {int(one): printable(name) for one, name in run.get("names", {}).items()})
    names, vectors = names_of_masks(folder) | given, read_embeddings(folder, len(stored.points))
    result = Result(**values, scene=scene, config=config, saved_embeddings=vectors, segment_names=names, manifest=of)
    if edits and has_file(folder / EDITS):
        result = edited(result, read_edits(folder, Parts(result).count))
    manifest.check_same(folder, of)
    return result


def _check_counts(folder: Path, result: Segmentation) -> None:
    """Compares the counts of run.yaml, which also version 0.1.0 wrote."""
    expected, _ = read_record(folder)
    got = {"points": len(result.points), "frames": len(result.images), "point_segments": result.num_point_segments}
    if expected != got:
        raise ValueError(f"{folder}: expected the counts of run.yaml, {expected}, got {got}; of another result?")
