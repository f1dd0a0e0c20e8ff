"""Finds the recordings that a user names: folders, patterns, data sets, and files that list them."""

import glob
import os
import re
from collections import Counter
from collections.abc import Iterable
from itertools import product
from pathlib import Path

from torchjoint.datasets import list_scenes
from torchjoint.runtime.files import file_name
from torchjoint.runtime.foreign_files import damage_is, has_folder, is_there, or_unreadable, read_text

#: A file with one of these suffixes lists recordings, one per line.
LISTS = (".txt", ".list")
#: How a line with coordinates begins.
POINT = re.compile(rb"\s*([-+]?[\d.]+(e[-+]?\d+)?[\s,;]+){2}[-+]?[\d.]", re.IGNORECASE)
#: Files of a batch, beside the folders of its results.
RECORD, SUMMARY, FAILURES = "batch.yaml", "summary.csv", "failures.csv"


def find_recordings(scenes: str | Path | Iterable[str | Path]) -> dict[str, Path]:
    """Returns recordings by name, for :func:`torchjoint.datasets.load_scene`.

    Args:
        scenes: one or several of: a recording; the folder of a data set, for all its scenes; a pattern such as
            ``scans/*`` (``**`` matches folders at any depth; matching files that are no recordings, and folders of
            batches, are ignored); a ``.txt`` or ``.list`` file with one of these per line, relative to the file. ``#``
            begins a comment line. A file whose first line is the coordinates of a point is a cloud.

    Returns:
        paths by names. If two recordings have the same name, all names begin with the names of parent folders, or have
        the suffixes. Paths that do not exist or have no known format are returned too: loading them raises the error.

    Raises:
        ValueError: there is no recording, a pattern matches nothing, or a list cannot be read or names itself.
    """
    given = [scenes] if isinstance(scenes, str | Path) else list(scenes)
    found = {path.parent.resolve() / path.name: path for one in given for path in _expanded(one)}
    if not found:
        raise ValueError("scenes: expected at least one recording, got none")
    return _named([*found.values()])


def _expanded(scene: str | Path, folder: Path = Path(), lists: tuple[Path, ...] = ()) -> list[Path]:
    """The recordings of one that a user names; `folder`: of the list that names it; `lists`: that one, those before."""
    path = folder / scene
    if path.suffix.lower() in LISTS and os.path.isfile(path) and not _is_cloud(path):
        if (own := path.resolve()) in lists:
            raise ValueError(f"scenes: expected a list of recordings, got {path}, which names itself")
        return [found for line in _lines(path) for found in _expanded(line, path.parent, (*lists, own))]
    if not or_unreadable(is_there, path) and glob.has_magic(str(scene)):
        pattern = str(Path(glob.escape(str(folder))) / scene)
        matches = [Path(match) for match in sorted(glob.glob(pattern, recursive=True))]
        recordings = [found for match in matches if not _is_other(match) for found in _scenes(match, True)]
        if not recordings:
            raise ValueError(f"scenes: {scene} matches no recording")
        return recordings
    return _scenes(path)


def _is_cloud(path: Path) -> bool:
    """Whether a file of text begins with the coordinates of a point."""
    with path.open("rb") as file:
        return POINT.match(file.readline(1000)) is not None


def _lines(path: Path) -> list[str]:
    with damage_is(f"{path}: expected a list of recordings, one per line"):
        lines = [line.strip() for line in read_text(path, "a list of scenes").splitlines()]
    return [line for line in lines if line and not line.startswith("#")]


def _scenes(path: Path, is_match: bool = False) -> list[Path]:
    """The scenes of a data set; any other path is returned itself, unless it is a file that matches a pattern."""
    try:
        return list(list_scenes(path).values())
    except (ValueError, OSError):
        return [] if is_match and not or_unreadable(has_folder, path) else [path]


def _is_other(path: Path) -> bool:
    """Whether what matches a pattern is a list, or has the results of a batch."""
    return path.suffix.lower() in LISTS or all(os.path.isfile(path / name) for name in (RECORD, SUMMARY))


def _named(paths: list[Path]) -> dict[str, Path]:
    deepest = max(len(_parts(path)) for path in paths)
    for has_suffix, depth in product((False, True), range(1, deepest + 1)):
        names = [_name(path, has_suffix, depth) for path in paths]
        if len(set(names)) == len(names):
            break
    same = Counter(map(str.casefold, names))  # some disks take them for one
    named = zip(names, paths, strict=True)
    return {one if same[one.casefold()] == 1 else file_name(f"{one}/{path.absolute()}"): path for one, path in named}


def possible_names(path: Path) -> list[str]:
    """The names that a recording can have, by the others of its batch."""
    depths = range(1, len(_parts(path)) + 1)
    return [*dict.fromkeys(_name(path, suffix, depth) for suffix, depth in product((False, True), depths))]


def _name(path: Path, has_suffix: bool, depth: int) -> str:
    """The name of a result's folder; no file of the batch, and no file beside another result, has it."""
    name = "-".join(_parts(path, has_suffix)[-depth:])
    is_free = name not in (RECORD, SUMMARY, FAILURES) and not name.endswith(".partial") and not name.startswith(".")
    return file_name(name, is_free=is_free)


def _parts(path: Path, has_suffix: bool = False) -> list[str]:
    """The names of the folders above a recording, then its own name."""
    absolute = path.absolute()
    return [*absolute.parent.parts[1:], absolute.stem if os.path.isfile(path) and not has_suffix else absolute.name]
