"""The recordings that a user names: folders, patterns, data sets, and files that list them."""

from __future__ import annotations

import glob
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from torchjoint.datasets import list_scenes

#: A file with one of these suffixes lists recordings, one a line.
LISTS = (".txt", ".list")


def find_recordings(scenes: str | Path | Iterable[str | Path]) -> dict[str, Path]:
    """Returns recordings by name, for :func:`torchjoint.datasets.load_scene`.

    Args:
        scenes: one or several of: a recording; the folder of a data set, which stands for all its scenes; a pattern
            such as ``scans/*`` (``**`` matches folders at any depth; of files only those count that are recordings);
            a ``.txt`` or ``.list`` file with one of these a line, relative to the file; lines with ``#`` are comments.

    Returns:
        paths by names. If two have the same name, all names begin with those of their parents. What does not exist,
        or is of no known format, is returned too: loading it says why it is none.

    Raises:
        ValueError: a pattern that matches nothing, or nothing at all; a list that cannot be read.
    """
    given = [scenes] if isinstance(scenes, str | Path) else list(scenes)
    found = list(dict.fromkeys(Path(path) for one in given for path in _expanded(one)))
    if not found:
        raise ValueError("scenes: expected at least one recording, got none")
    return _named(found)


def _expanded(scene: str | Path) -> list[Path]:
    path = Path(scene)
    if path.suffix.lower() in LISTS and path.is_file():
        return [found for line in _lines(path) for found in _expanded(path.parent / line)]
    if not path.exists() and glob.has_magic(str(scene)):
        matches = [Path(match) for match in sorted(glob.glob(str(scene), recursive=True))]
        recordings = [found for match in matches for found in _scenes(match) if match.is_dir() or _is_scene(match)]
        if not recordings:
            raise ValueError(f"scenes: {scene} matches no recording")
        return recordings
    return _scenes(path)


def _lines(path: Path) -> list[str]:
    try:
        lines = [line.strip() for line in path.read_text(encoding="utf-8").splitlines()]
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: expected a list of recordings, one a line: {error}") from error
    return [line for line in lines if line and not line.startswith("#")]


def _scenes(path: Path) -> list[Path]:
    """The scenes of a data set; what is none stands for itself."""
    try:
        return list(list_scenes(path).values())
    except (ValueError, OSError):
        return [path]


def _is_scene(path: Path) -> bool:
    try:
        list_scenes(path)
    except (ValueError, OSError):
        return False
    return True


def _named(paths: list[Path]) -> dict[str, Path]:
    depth = 1
    while True:
        names = ["-".join(_parts(path)[-depth:]) for path in paths]
        if max(Counter(names).values()) == 1:
            return dict(zip(names, paths, strict=True))
        if depth > max(len(_parts(path)) for path in paths):
            twice = next(name for name in names if names.count(name) > 1)
            raise ValueError(f"scenes: two recordings would both have the result {twice}")
        depth += 1


def _parts(path: Path) -> list[str]:
    """The names of the folders above a recording, and its own."""
    absolute = path.absolute()
    own = absolute.stem if path.is_file() else absolute.name
    return [*absolute.parent.parts[1:], own]
