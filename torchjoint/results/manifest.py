"""The files that belong together in a result: manifest.json has the size and checksum of each that `load_result` reads.

It says so if a file was changed, lost, or taken from another result. A result of version 0.1.0 has none.
"""

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from torchjoint.config import read_yaml
from torchjoint.datasets.files.readers import read_image
from torchjoint.runtime.archives import read_archive
from torchjoint.runtime.files import file_checksum, write_text
from torchjoint.runtime.foreign_files import damage_is, has_file, present, read_json
from torchjoint.runtime.threads import parallel_map
from torchjoint.scene import Hierarchy
from torchjoint.scene.hierarchy import Votes

FILE, RUN = "manifest.json", "run.yaml"
#: The files that are checked when a result is opened.
AT_ONCE = ("points.npz", "hierarchy.npz", "cameras.json", "masks.json")
#: Those that are checked when they are read.
WHEN_READ = ("images/*.png", "pieces/*.png", "inputs/*.jpg")
READ = (*AT_ONCE, *WHEN_READ)
#: Those that nothing reads: they may be missing, but what a user made of them is not replaced.
SHOWN = ("points.ply", "cloud-*mm.ply", "images_color/*.jpg")

#: A function that returns the path of a result's file, or raises ValueError if it is not what was written.
Check = Callable[[Path], Path]


def write_manifest(folder: Path, record: Mapping[str, Any]) -> None:
    """Writes manifest.json of a result whose other files are written; `record` is the content of run.yaml."""

    def line(name: str) -> str:
        return f"{json.dumps(name)}: {json.dumps(_entry(folder / name))}"

    files, shown = (",\n".join(parallel_map(line, _names(folder, kinds))) for kinds in (READ, SHOWN))
    head = f'"run": "{_checksum(record)}"'
    write_text(folder / FILE, f'{{{head}, "files": {{\n{files}\n}}, "shown": {{\n{shown}\n}}}}\n')


def _entry(file: Path) -> list[Any]:
    return [file.stat().st_size, file_checksum(file)]


def manifest_checksum(folder: Path) -> str | None:
    """What tells one result from another: the checksum of its manifest; None for a result that has none."""
    return file_checksum(folder / FILE) if (folder / FILE).is_file() else None


def check_same(folder: Path, opened: str | None) -> None:
    """Checks that a folder still has the result of this manifest: a run may have replaced it."""
    if opened not in (None, manifest_checksum(folder)):
        raise ValueError(f"{folder}: expected the result that was opened, got another, or none; open it again")


def unchecked(path: Path) -> Path:
    """Returns the path."""
    return path


def open_manifest(folder: Path) -> Check:
    """Checks what a result consists of; returns the check of single files, for those that are read later."""
    record = read_yaml(folder / RUN, dict, "a record of a run")
    if "manifest" not in record and not has_file(folder / FILE):  # of version 0.1.0
        return unchecked
    present(folder / FILE, f"the list of a result's files{_WAY_OUT}")
    opened, files = manifest_checksum(folder), _read(folder / FILE, record)
    names = set(_names(folder))
    for name in sorted(files.keys() - names):
        present(folder / name, f"a whole result{_WAY_OUT}")
    for name in sorted(names - files.keys()):
        raise ValueError(f"{folder / name}: expected only files that the run wrote, got another{_WAY_OUT}")

    def check(path: Path) -> Path:
        if not has_file(path) or files.get(path.relative_to(folder).as_posix()) != _entry(path):
            check_same(folder, opened)
            present(path, "a file of a result")
            raise ValueError(f"{path}: expected the file that the run wrote, got another, or a damaged one{_WAY_OUT}")
        return path

    for name in filter(files.__contains__, AT_ONCE):
        check(folder / name)
    return check


def check_sizes(folder: Path) -> tuple[str, ...]:
    """Checks that the files of a result are there and have their sizes, without reading them: results may be many.

    Returns:
        what is told of files that are missing and that nothing reads, at most three.
    """
    record = read_yaml(folder / RUN, dict, "a record of a run")
    for name, (size, _) in _read(folder / FILE, record).items():
        if present(folder / name, "a whole result").stat().st_size != size:
            raise ValueError(f"{folder / name}: expected the {size} bytes that the run wrote; delete the result")
    shown = _read(folder / FILE, record, "shown")
    return tuple(f"{name} is missing in the result" for name in shown if not has_file(folder / name))[:3]


def listed_files(folder: Path) -> dict[str, list[Any]]:
    """Size and checksum of each file of a result, as its run wrote them; empty for a result without a manifest.

    Raises:
        ValueError: a file is there that is not as the run wrote it, such as an image that a user painted by hand.
    """
    manifest = folder / FILE
    with damage_is(f"{manifest}: not the list of a result's files; move or delete its folder"):
        content = read_json(manifest, "a list of files") if manifest.is_file() else {"files": {}}
        files = dict(content["files"]) | dict(content.get("shown", {}))
    for name in filter(files.__contains__, _names(folder, (*READ, *SHOWN))):
        if files[name] != _entry(folder / name):
            raise ValueError(f"{folder / name}: is not as the run wrote it; move or delete it, then start again")
    return files


_WAY_OUT = "; load_result(..., verify=False) reads it all the same"


def _names(folder: Path, kinds: Sequence[str] = READ) -> list[str]:
    """The names of a result's files of some kinds, relative to its folder, without ._NAME of macOS."""
    found = (file for one in kinds for file in folder.glob(one) if file.name[:2] != "._")
    return sorted(file.relative_to(folder).as_posix() for file in found)


def _read(file: Path, record: Mapping[str, Any], kind: str = "files") -> dict[str, list[Any]]:
    with damage_is(f"{file}: not the list of a result's files"):
        content = read_json(file, "a list of files")
        run, files = content["run"], dict({"shown": {}, **content}[kind])
    if run != _checksum(record):
        raise ValueError(f"{file.parent / RUN}: expected the record of this result, got another{_WAY_OUT}")
    return files


def _checksum(record: Mapping[str, Any]) -> str:
    """Of a run's record without its seconds, so that equal results have equal manifests."""
    timeless = {key: value for key, value in record.items() if key not in ("seconds", "thread_seconds")}
    return hashlib.sha256(json.dumps(timeless, sort_keys=True, default=str).encode()).hexdigest()


HIERARCHY, SUPERPOINTS = "hierarchy.npz", "pieces"
#: How images of labels are packed: by runs (zlib's Z_RLE), which is faster than other ways, and makes them smaller.
PNG: dict[str, Any] = {"compress_level": 1, "compress_type": 3}
#: Largest number of a superpoint in an image of superpoints, which stores superpoint + 1 in three bytes; 0 = none.
MAX_SUPERPOINT = 2**24 - 2
#: Names of the arrays of the votes. Results without ensemble have none.
_VOTES = ("votes", "piece_size")


def write_hierarchy(folder: Path, hierarchy: Hierarchy, names: Sequence[str], superpoints: Sequence[Tensor]) -> None:
    """Writes hierarchy.npz and pieces/NAME.png; equal arguments give equal bytes.

    Args:
        folder: the result.
        hierarchy: of the points.
        names: of the images, without suffix.
        superpoints: [H, W] int64 per image, -1 = none.
    """
    if hierarchy.num_superpoints - 1 > MAX_SUPERPOINT:
        count = f"{hierarchy.num_superpoints} superpoints"
        raise ValueError(f"hierarchy: {count} do not fit 24-bit images (at most {MAX_SUPERPOINT + 1})")
    arrays = {"piece": hierarchy.superpoint, "merges": hierarchy.merges}
    if hierarchy.votes is not None:
        arrays |= dict(zip(_VOTES, hierarchy.votes, strict=True))
    floats = {"heights": hierarchy.heights.numpy(), "default": np.float64(hierarchy.default)}
    whole = {name: array.numpy().astype(np.int32) for name, array in arrays.items()}
    np.savez_compressed(folder / HIERARCHY, **floats, **whole)  # type: ignore[arg-type]
    if not len(superpoints):
        return
    (folder / SUPERPOINTS).mkdir()

    def write(index: int) -> None:
        stored = (superpoints[index] + 1).numpy().astype(">u4", order="C")
        channels = stored.view(np.uint8).reshape(*stored.shape, 4)[..., 1:]
        Image.fromarray(channels).save(folder / SUPERPOINTS / f"{names[index]}.png", **PNG)

    parallel_map(write, range(len(names)))


def read_hierarchy(folder: Path, num_points: int) -> Hierarchy:
    """Reads hierarchy.npz of a result that has `num_points` points."""
    file = folder / HIERARCHY
    present(file, "a result with all levels; point_segments.method paper makes one")
    with damage_is(f"{file}: not a whole hierarchy", OSError):
        arrays = read_archive(file)
        names = ["piece", "merges", *(name for name in _VOTES if name in arrays)]
        whole = (arrays[name].astype(np.int64, casting="same_kind") for name in names)  # floats would be cut
        superpoint, merges, *found = map(torch.from_numpy, whole)
        votes = Votes(*found) if found else None
        hierarchy = Hierarchy(superpoint, merges, torch.from_numpy(arrays["heights"]), float(arrays["default"]), votes)
    if len(hierarchy.superpoint) != num_points:
        raise ValueError(f"{file}: expected a hierarchy of {num_points} points, got {len(hierarchy.superpoint)}")
    return hierarchy


def read_superpoint_image(path: Path, num_superpoints: int) -> Tensor:
    """Reads an image of superpoints; returns [H, W] int64, -1 = none."""
    red, green, blue = read_image(path).to(torch.int64)
    superpoints = (red << 16) + (green << 8) + blue - 1
    if (last := int(superpoints.max())) >= num_superpoints:
        raise ValueError(f"{path}: expected superpoints below {num_superpoints}, got {last}; of another result?")
    return superpoints
